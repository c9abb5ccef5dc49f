"""Slicer markups `.mrk.json`: points and lines in the coordinates of a CT, LPS in mm."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from procedures.exchange.export_tables import LPS, MILLIMETRE, CtIdentity

Point = tuple[float, float, float]
Colour = tuple[float, float, float]  # red, green, blue, 0 to 1

MARKUPS_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
DEFINED_POINT = {"selected": True, "locked": True, "visibility": True, "positionStatus": "defined"}
YELLOW: Colour = (1.0, 0.8, 0.2)


def build_markup(
    kind: Literal["Fiducial", "Line"],
    name: str,
    points: Mapping[str, tuple[Sequence[float], str]],
    *,
    colour: Colour = YELLOW,
    measurements: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Build a locked markup from its points: label to position and description."""
    control_points = []
    for number, (label, (position, description)) in enumerate(points.items(), 1):
        named = {"id": str(number), "label": label, "description": description}
        control_points.append({**named, "position": [float(value) for value in position], **DEFINED_POINT})
    return {
        "type": kind,
        "name": name,
        "coordinateSystem": LPS,
        "coordinateUnits": MILLIMETRE,
        "locked": True,
        "fixedNumberOfControlPoints": True,
        "controlPoints": control_points,
        "measurements": list(measurements),
        "display": {
            "visibility": True,
            "color": list(colour),
            "selectedColor": list(colour),  # that of a control point that is selected, as all are
            "propertiesLabelVisibility": True,
            "pointLabelsVisibility": kind == "Fiducial",
        },
    }


def format_markups(markups: Sequence[Mapping[str, Any]], ct: CtIdentity, direction: str) -> str:
    """Format a markups file, which also says in which frame its points are and from which mapping."""
    content = {"@schema": MARKUPS_SCHEMA, **ct.describe(direction), "markups": list(markups)}
    return json.dumps(content, indent=1, allow_nan=False) + "\n"
