"""Export of localized spheres as Slicer markups, JSON, CSV or DICOM, by file extension."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from procedures.exchange.allowed_fields import LPS_COLUMNS, PLANNING_CT_COLUMNS, name_spheres
from procedures.exchange.errors import NOT_WRITABLE, UNKNOWN_FORM
from procedures.exchange.export_tables import IN_CT, CtIdentity, format_table
from procedures.exchange.slicer_markups import build_markup, format_markups
from ronna_hw.calibration import Numbers3
from ronna_hw.records import canonical_json, write_atomically

if TYPE_CHECKING:
    from procedures.exchange.ct_study import CtStudy
    from procedures.imaging import Localization, Marker

MARKUPS, JSON, CSV, DICOM = ".mrk.json", ".json", ".csv", ".dcm"


def check_names(paths: Sequence[Path]) -> None:
    """Raise EXC-001 for a file name with an unknown extension. Cheap enough to call before any work."""
    for path in paths:
        if not path.name.endswith((MARKUPS, JSON, CSV, DICOM)):
            raise UNKNOWN_FORM(f"cannot tell the format of {path.name}")


def is_dicom(path: Path) -> bool:
    """Tell whether a file of this name is a DICOM object."""
    return path.name.endswith(DICOM)


def write_spheres(
    spheres_found: Localization,
    paths: Sequence[Path],
    study_instance_uid: str = "",
    study: CtStudy | None = None,
) -> None:
    """Write the spheres to each file. DICOM files name the patient of the `study`, if it is given.

    Raises EXC-001, EXC-002.
    """
    check_names(paths)
    if not paths:
        return
    from procedures.exchange import dicom_objects  # pydicom: half a second

    numbered = dict(enumerate(spheres_found.markers, start=1))
    markers = {number: marker.document() for number, marker in numbered.items()}
    key = hashlib.sha256(canonical_json(list(markers.values()))).hexdigest()
    origin = dicom_objects.Origin(
        spheres_found.series_instance_uid,
        spheres_found.frame_of_reference_uid,
        datetime.now(UTC),
        key,
        study_instance_uid,
    )
    ct = CtIdentity(origin.series_instance_uid, origin.frame_of_reference_uid, study_instance_uid)
    for path in paths:
        if is_dicom(path):
            made = dicom_objects.sphere_fiducials(numbered, origin)
            dicom_objects.write(made if study is None else study.file_object(made), path)
            continue
        if path.name.endswith(MARKUPS):
            text = slicer_markups(numbered, ct)
        else:
            text = document(markers, ct) if path.name.endswith(JSON) else table(numbered, ct)
        try:
            write_atomically(path, text.encode())
        except OSError as error:
            raise NOT_WRITABLE(f"cannot write {path}: {error.strerror}") from error


def slicer_markups(numbered: Mapping[int, Marker], ct: CtIdentity) -> str:
    """Format a `.mrk.json` with one control point per sphere, LPS in mm."""
    points = {
        name: (marker.centre_mm, f"uncertainty {marker.sigma_mm:.4f} mm rms")
        for name, marker in name_spheres(numbered).items()
    }
    return format_markups([build_markup("Fiducial", "spheres", points)], ct, IN_CT)


def table(
    numbered: Mapping[int, Marker], ct: CtIdentity, planning_ct_mm: Mapping[int, Numbers3] | None = None
) -> str:
    """Format a CSV with name, L, P, S and uncertainty in mm.

    `planning_ct_mm` are the places by number in the planning CT, if these are of a later scan.
    """
    rows = []
    for number, (name, one) in zip(numbered, name_spheres(numbered).items(), strict=True):
        in_ct = one.centre_mm if planning_ct_mm is None else planning_ct_mm.get(number, (None,) * 3)
        places = dict(zip((*LPS_COLUMNS, *PLANNING_CT_COLUMNS), (*one.centre_mm, *in_ct), strict=True))
        rows.append({"name": name, **places, "uncertainty_mm": one.sigma_mm, **ct.describe(IN_CT)})
    return format_table("spheres.csv", rows)


def document(numbered: Mapping[int, Mapping[str, Any]], ct: CtIdentity) -> str:
    """Format the spheres and their series as JSON, in localization order and LPS mm."""
    content = {
        **ct.describe(IN_CT),
        "spheres": [{"name": name, **marker} for name, marker in name_spheres(numbered).items()],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"
