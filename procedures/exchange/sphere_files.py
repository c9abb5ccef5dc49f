"""Export of localized spheres as Slicer markups, JSON, CSV or DICOM, by file extension."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from procedures.exchange.allowed_fields import name_spheres
from procedures.exchange.errors import NotWritable, UnknownForm
from ronna_hw.records import canonical_json, write_atomically

if TYPE_CHECKING:
    from procedures.exchange.dicom_objects import Origin
    from procedures.imaging import Localization, Marker, PatientIdentity

MARKUPS, JSON, CSV, DICOM = ".mrk.json", ".json", ".csv", ".dcm"
MARKUPS_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)


def check_names(paths: Sequence[Path]) -> None:
    """Raise EXC-001 for a file name with an unknown extension. Cheap enough to call before any work."""
    for path in paths:
        if not path.name.endswith((MARKUPS, JSON, CSV, DICOM)):
            raise UnknownForm(f"cannot tell the format of {path.name}")


def write_spheres(
    spheres_found: Localization, paths: Sequence[Path], patient: PatientIdentity | None = None
) -> None:
    """Write the spheres to each file. Only DICOM files include the `patient`.

    Raises EXC-001, EXC-002.
    """
    check_names(paths)
    if not paths:
        return
    from procedures.exchange import dicom_objects  # pydicom: half a second

    markers = [marker.document() for marker in spheres_found.markers]
    key = hashlib.sha256(canonical_json(markers)).hexdigest()
    origin = dicom_objects.Origin(
        spheres_found.series_instance_uid, spheres_found.frame_of_reference_uid, datetime.now(UTC), key
    )
    for path in paths:
        if path.name.endswith(DICOM):
            made = dicom_objects.sphere_fiducials(spheres_found.markers, origin)
            if patient is not None:
                dicom_objects.name_patient(
                    made, patient.name, patient.identifier, patient.birth_date, patient.sex
                )
            dicom_objects.write(made, path)
            continue
        if path.name.endswith(MARKUPS):
            text = slicer_markups(spheres_found.markers)
        else:
            text = document(markers, origin) if path.name.endswith(JSON) else table(spheres_found.markers)
        try:
            write_atomically(path, text.encode())
        except OSError as error:
            raise NotWritable(f"cannot write {path}: {error.strerror}") from error


def slicer_markups(markers: Sequence[Marker]) -> str:
    """Format a `.mrk.json` with one control point per sphere, LPS in mm."""
    points = [
        {
            "id": str(number),
            "label": name,
            "description": f"uncertainty {marker.sigma_mm:.4f} mm rms",
            "position": list(marker.centre_mm),
            "selected": True,
            "locked": True,
            "visibility": True,
            "positionStatus": "defined",
        }
        for number, (name, marker) in enumerate(name_spheres(markers).items(), 1)
    ]
    markups = [
        {"type": "Fiducial", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": points}
    ]
    return json.dumps({"@schema": MARKUPS_SCHEMA, "markups": markups}, indent=1, allow_nan=False) + "\n"


def table(markers: Sequence[Marker]) -> str:
    """Format a CSV with name, L, P, S and uncertainty in mm."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("name", "L_mm", "P_mm", "S_mm", "uncertainty_mm"))
    writer.writerows((name, *one.centre_mm, one.sigma_mm) for name, one in name_spheres(markers).items())
    return text.getvalue()


def document(markers: Sequence[Mapping[str, Any]], origin: Origin) -> str:
    """Format the spheres and their series as JSON, in localization order and LPS mm."""
    content = {
        "series_instance_uid": origin.series_instance_uid,
        "frame_of_reference_uid": origin.frame_of_reference_uid,
        "coordinate_system": "LPS",
        "unit": "mm",
        "spheres": [{"name": name, **marker} for name, marker in name_spheres(markers).items()],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"
