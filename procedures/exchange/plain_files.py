"""Spheres as JSON, as a Slicer markups file and as CSV; registrations as CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from procedures.exchange.dicom_object import Origin
from procedures.exchange.spatial_fiducials import Fiducial
from procedures.steps.clinical.results import RegisteredRobot

MARKUPS_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)


def slicer_markups(fiducials: Sequence[Fiducial]) -> str:
    """A `.mrk.json` with one control point per sphere, LPS in mm."""
    points = [
        {
            "id": str(number),
            "label": fiducial.name,
            "description": f"uncertainty {fiducial.uncertainty_mm:.4f} mm rms",
            "position": list(fiducial.centre_mm),
            "selected": True,
            "locked": True,
            "visibility": True,
            "positionStatus": "defined",
        }
        for number, fiducial in enumerate(fiducials, 1)
    ]
    markups = [
        {"type": "Fiducial", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": points}
    ]
    return json.dumps({"@schema": MARKUPS_SCHEMA, "markups": markups}, indent=1, allow_nan=False) + "\n"


def table(fiducials: Sequence[Fiducial]) -> str:
    """CSV with name, L, P, S and uncertainty in mm."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("name", "L_mm", "P_mm", "S_mm", "uncertainty_mm"))
    writer.writerows((one.name, *one.centre_mm, one.uncertainty_mm) for one in fiducials)
    return text.getvalue()


def document(markers: Sequence[Mapping[str, Any]], origin: Origin) -> str:
    """JSON of the spheres as localized, M1 first, LPS in mm, with their series."""
    content = {
        "series_instance_uid": origin.series_instance_uid,
        "frame_of_reference_uid": origin.frame_of_reference_uid,
        "coordinate_system": "LPS",
        "unit": "mm",
        "spheres": [{"name": f"M{number}", **marker} for number, marker in enumerate(markers, 1)],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def registration_table(registrations: Iterable[RegisteredRobot]) -> str:
    """CSV with one row per target, even if several share a registration: the matrix row by row, the error."""
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
