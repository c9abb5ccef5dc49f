"""Spheres as a Slicer markups file and as CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence

from procedures.exchange.spatial_fiducials import Fiducial

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
