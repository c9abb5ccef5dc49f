"""Export a finished run: spheres, one registration per trajectory, in the forms that other programs read."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from procedures.exchange.dicom_object import Origin, write
from procedures.exchange.errors import NothingToExport, NotWritable
from procedures.exchange.plain_files import document, registration_table, slicer_markups, table
from procedures.exchange.spatial_fiducials import Fiducial, fiducial_uid, spatial_fiducials
from procedures.exchange.spatial_registration import spatial_registration
from procedures.steps.payloads import pose_from
from ronna_hw.records import Record, read_record

SPHERES = "fiducial_localization"
REGISTRATION = "registration"


def export_run(run: Path, out: Path) -> list[Path]:
    """Write everything that the run `run` found into `out`; the files. Raises EXC-002, EXC-003, REC-001."""
    records = [read_record(path) for path in sorted((run / "records").glob("*.json"))]
    imported = _last(records, "ct_import", run)
    found = _last(records, SPHERES, run)
    spheres = fiducials(found.payload["markers"])
    origin = Origin(
        imported.payload["series_instance_uid"],
        imported.payload["frame_of_reference_uid"],
        datetime.fromisoformat(found.created),
        found.sha256,
    )
    fits = {_trajectory(one): one for one in records if one.kind == REGISTRATION}
    if not fits:
        raise NothingToExport(f"{run.name} has no registration")
    poses = {name: pose_from(fit.payload["robot_from_ct"]).rigid.as_matrix() for name, fit in fits.items()}
    texts = {
        "spheres.csv": table(spheres),
        "spheres.json": document(found.payload["markers"], origin),
        "spheres.mrk.json": slicer_markups(spheres),
        "registrations.csv": registration_table({name: (poses[name], fits[name].payload) for name in fits}),
        "registrations.json": _summary(fits),
    }
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (out / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise NotWritable(f"cannot write into {out}: {error.strerror}") from error
    written = [out / name for name in texts]
    written.append(write(spatial_fiducials(spheres, origin), out / "spheres.dcm"))
    for trajectory, fit in fits.items():
        made = spatial_registration(
            poses[trajectory],
            replace(origin, made=datetime.fromisoformat(fit.created), key=fit.sha256),
            spheres=origin,
            description=f"trajectory {trajectory}",
            fiducial_uids=[fiducial_uid(origin, one) for one in spheres],
        )
        written.append(write(made, out / f"registration-{trajectory}.dcm"))
    return written


def fiducials(markers: list[dict[str, Any]]) -> tuple[Fiducial, ...]:
    """Spheres of a localization's payload, named M1, M2, ... in its order."""
    made = []
    for number, marker in enumerate(markers, 1):
        x, y, z = (float(value) for value in marker["centre_mm"])
        rms_mm = float(np.sqrt(np.trace(np.array(marker["covariance_mm2"]))))
        made.append(Fiducial(f"M{number}", (x, y, z), rms_mm))
    return tuple(made)


def _summary(fits: dict[str, Record]) -> str:
    wanted = ("robot_from_ct", "pairs", "fre_mm", "predicted_tre_mm", "predicted_tre_limit_mm", "confidence")
    document = [
        {"trajectory": name, **{key: fit.payload[key] for key in wanted}, "record": fit.sha256}
        for name, fit in fits.items()
    ]
    return json.dumps({"registrations": document}, indent=1, allow_nan=False) + "\n"


def _trajectory(record: Record) -> str:
    """The trajectory of a record such as `09-registration-T1`."""
    return record.identifier.partition(f"-{REGISTRATION}-")[2]


def _last(records: list[Record], kind: str, run: Path) -> Record:
    for record in reversed(records):
        if record.kind == kind:
            return record
    raise NothingToExport(f"{run.name} has no record of {kind}")
