"""Export of a finished run to common formats: its spheres, and one registration per trajectory."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TypeVar

from procedures.engine.case import Stored, ancestor_of_kind
from procedures.engine.run_folder import RunFolder, run_of
from procedures.exchange.allowed_fields import (
    REGISTRATION_FIELDS,
    SPHERE_FIELDS,
    label_of,
    name_spheres,
    pick_allowed,
    require_allowed,
)
from procedures.exchange.dicom_objects import (
    Origin,
    fiducial_uid,
    spatial_registration,
    sphere_fiducials,
    write,
)
from procedures.exchange.errors import NothingToExport, NotWritable
from procedures.exchange.sphere_files import document, slicer_markups, table
from procedures.journal.results import StepResult
from procedures.reporting.run_reading import UsedRegistration, find_used_registrations
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.results import RegisteredRobot
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.records import Record, write_atomically

R = TypeVar("R", bound=StepResult)
ALL = "all"  # name of a registration that serves every trajectory


def export_run(run: Path, out: Path) -> list[Path]:
    """Write the exportable results of a run to `out` and return the files.

    Raises EXC-002, EXC-003, EXC-004, REC-003, and PRO-033 before anything is written. EXC-002 also for a
    folder with registrations of another run.
    """
    folder = run_of(inspect_run(run).require_whole())
    imported, found = _require_result(folder, ImportedCt), _require_result(folder, LocalizedFiducials)
    spheres = found.result.markers
    origin = Origin(
        imported.result.series_instance_uid,
        imported.result.frame_of_reference_uid,
        datetime.fromisoformat(found.record.created),
        found.record.sha256,
    )
    fits = _label_registrations(
        find_used_registrations(folder.made(RegisteredRobot), folder.records, folder.superseded)
    )
    if not fits:
        raise NothingToExport(f"{run.name} has no registration")
    markers = [pick_allowed(one.model_dump(mode="json"), SPHERE_FIELDS) for one in spheres]
    texts = {
        "spheres.csv": table(spheres),
        "spheres.json": document(markers, origin),
        "spheres.mrk.json": slicer_markups(spheres),
        "registrations.csv": _registration_table(fit.result for fit in fits.values()),
        "registrations.json": _summary(fits),
    }
    own = {_file_of(trajectory) for trajectory in fits}
    if others := sorted(file.name for file in out.glob(_file_of("*")) if file.name not in own):
        raise NotWritable(
            f"{out} holds registrations that are not of this run",
            expected="a new folder, or an earlier export of this run",
            got=", ".join(others),
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            write_atomically(out / name, text.encode())
    except OSError as error:
        raise NotWritable(f"cannot write into {out}: {error.strerror}") from error
    written = [out / name for name in texts]
    written.append(write(require_allowed(sphere_fiducials(spheres, origin)), out / "spheres.dcm"))
    for trajectory, fit in fits.items():
        made = spatial_registration(
            fit.result.robot_from_ct.transform,
            replace(origin, made=datetime.fromisoformat(fit.record.created), key=fit.record.sha256),
            spheres=origin,
            placing=_placing(fit.record, folder),
            description=f"trajectory {trajectory}",
            fiducial_uids=[fiducial_uid(origin, name) for name in name_spheres(spheres)],
        )
        written.append(write(require_allowed(made), out / _file_of(trajectory)))
    return written


def _file_of(trajectory: str) -> str:
    return f"registration-{trajectory}.dcm"


def _label_registrations(used: Sequence[UsedRegistration]) -> dict[str, Stored[RegisteredRobot]]:
    """Return the registrations by export label, with their targets relabelled too."""
    names = dict.fromkeys(name for one in used for name in one.targets)
    labels = {name: label_of(name, number) for number, name in enumerate(names, 1)}
    is_single = [one.stored.record.trajectory for one in used].count(None) == 1
    by_label = {}
    for one in used:
        predictions = tuple(
            predicted.model_copy(update={"target": labels[predicted.target]}) for predicted in one.predictions
        )
        result = one.result.model_copy(update={"predictions": predictions})
        for_all = is_single and one.stored.record.trajectory is None
        label = ALL if for_all else "-".join(labels[name] for name in one.targets)
        by_label[label] = Stored(one.stored.record, result)
    return by_label


def _placing(registration: Record, folder: RunFolder) -> str:
    """Return the hash of the locked-cart record, which identifies the cart position; '' if never locked."""
    by_name = {record.identifier: record for record in folder.records}
    locked = ancestor_of_kind(registration, LockedCart.kind, by_name)
    return "" if locked is None else locked.sha256


def _summary(fits: dict[str, Stored[RegisteredRobot]]) -> str:
    document = [
        {
            "trajectory": predicted.target,
            **pick_allowed(fit.result.model_dump(mode="json"), REGISTRATION_FIELDS),
            "predicted_tre_mm": predicted.rms_mm,
            "predicted_tre_limit_mm": predicted.limit_mm,
            "confidence": predicted.confidence,
            "record": fit.record.sha256,
        }
        for fit in fits.values()
        for predicted in fit.result.predictions
    ]
    return json.dumps({"registrations": document}, indent=1, allow_nan=False) + "\n"


def _registration_table(registrations: Iterable[RegisteredRobot]) -> str:
    """Format a CSV with one row per target: the matrix row by row, then the error."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    elements = [f"m{row}{column}" for row in range(1, 4) for column in range(1, 5)]
    figures = ("pairs", "fre_mm", "predicted_tre_mm", "predicted_tre_limit_mm", "confidence")
    writer.writerow(("trajectory", *elements, *figures))
    for one in registrations:
        matrix = one.robot_from_ct.transform.as_matrix()[:3].ravel().tolist()
        for predicted in one.predictions:
            error = (predicted.rms_mm, predicted.limit_mm, predicted.confidence)
            writer.writerow((predicted.target, *matrix, one.pairs, one.fre_mm, *error))
    return text.getvalue()


def _require_result(folder: RunFolder, model: type[R]) -> Stored[R]:
    found = folder.standing(model)
    if not found:
        raise NothingToExport(f"{folder.path.name} has no record of {model.kind}")
    return found[-1]
