"""TOML tool description, from which `ronna-rom make` builds a definition.

    part_number = "POINTER-1"
    markers_mm = [[0, 0, 0], [0, 50, 0], [0, 100, 0]]

is enough; the defaults suit a passive tool with one face.
"""

from __future__ import annotations

import json
import math
from datetime import date
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, ValidationError, model_validator

from drivers.ndi_polaris.errors import BAD_TOOL_FILE
from drivers.ndi_polaris.tool_definition import ToolDefinition, face_normal_of
from ronna_hw.bounded_input import read_toml
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.mistakes import describe_mistakes, find_other_kind
from ronna_hw.text import format_count
from ronna_hw.vectors import Vector3
from ronna_hw.wire import polaris_rom as layout

MAIN_TYPES = {
    "unknown": layout.MAIN_TYPE_UNKNOWN,
    "reference": layout.MAIN_TYPE_REFERENCE,
    "pointer": layout.MAIN_TYPE_POINTER,
    "button box": layout.MAIN_TYPE_BUTTON_BOX,
    "user defined": layout.MAIN_TYPE_USER_DEFINED,
    "microscope": layout.MAIN_TYPE_MICROSCOPE,
    "calibration block": layout.MAIN_TYPE_CALIBRATION_BLOCK,
    "dock": layout.MAIN_TYPE_DOCK,
    "isolation box": layout.MAIN_TYPE_ISOLATION_BOX,
    "C-arm": layout.MAIN_TYPE_C_ARM,
    "catheter": layout.MAIN_TYPE_CATHETER,
    "GPIO": layout.MAIN_TYPE_GPIO,
    "scan reference": layout.MAIN_TYPE_SCAN_REFERENCE,
}
MARKER_TYPES = {
    "sphere": layout.MARKER_PASSIVE_SPHERE,
    "disc": layout.MARKER_PASSIVE_DISC,
    "Radix lens": layout.MARKER_RADIX_LENS,
}
FIRST_YEAR, LAST_YEAR = layout.SERIAL_FIRST_YEAR + 1, layout.SERIAL_FIRST_YEAR + 511  # 9 bits; never all zero
LARGEST_SEQUENCE = 1023  # 10 bits
LARGEST_BYTE = 255

Byte = Annotated[int, Field(ge=0, le=LARGEST_BYTE)]


class ToolDescription(Strict):
    """Tool description as written by hand; lengths in mm, in the tool frame."""

    part_number: Annotated[str, Field(min_length=1, max_length=layout.PART_NUMBER_BYTES)]
    markers_mm: Annotated[tuple[Numbers3, ...], Field(min_length=3, max_length=layout.ROM_MARKERS)]
    manufacturer: Annotated[str, Field(min_length=1, max_length=layout.MANUFACTURER_BYTES)] = "RONNA"
    main_type: str = "reference"
    subtype: Byte | None = None  # none: main type minus 1, as in all real files
    revision: Annotated[int, Field(ge=0, le=999)] = 0  # PHINF has three digits for it
    made_on: date = date(2025, 1, 1)
    sequence: Annotated[int, Field(ge=1, le=LARGEST_SEQUENCE)] = 1
    normals: tuple[Numbers3, ...] = ((0.0, 0.0, 1.0),)  # one for all markers, or one per marker
    faces: tuple[Annotated[int, Field(ge=1, le=layout.ROM_FACES)], ...] = (1,)  # one for all, or one each
    face_normals: tuple[Numbers3, ...] = ()  # none: opposite to the mean normal of each face's markers
    maximum_angle_deg: Annotated[int, Field(ge=1, le=180)] = 90
    minimum_markers: Annotated[int, Field(ge=3, le=layout.ROM_MARKERS)] = 3
    maximum_error_mm: Annotated[float, Field(gt=0)] = 1.0
    minimum_spread_mm: Numbers3 = (0.0, 0.0, 0.0)
    unique_geometry: bool = True
    marker_type: str = "sphere"

    @model_validator(mode="after")
    def _require_consistent(self) -> Self:
        count = len(self.markers_mm)
        for name in ("normals", "faces"):
            if len(getattr(self, name)) not in (1, count):
                raise ValueError(f"{name} needs 1 or {count} entries")
        if len(set(self.faces)) != max(self.faces):
            raise ValueError("faces must be numbered from 1 without a gap")
        if self.face_normals and len(self.face_normals) != max(self.faces):
            raise ValueError(f"face_normals needs {max(self.faces)} entries")
        if any(math.hypot(*normal) == 0 for normal in (*self.normals, *self.face_normals)):
            raise ValueError("a normal has length 0")
        if self.main_type not in MAIN_TYPES:
            raise ValueError(f"main_type must be one of {', '.join(MAIN_TYPES)}")
        if self.marker_type not in MARKER_TYPES:
            raise ValueError(f"marker_type must be one of {', '.join(MARKER_TYPES)}")
        if not FIRST_YEAR <= self.made_on.year <= LAST_YEAR:
            raise ValueError(f"made_on must be from {FIRST_YEAR} to {LAST_YEAR}")
        return self

    def definition(self) -> ToolDefinition:
        """Convert to a tool definition; raises NDI-011 for content that the format cannot express."""
        count = len(self.markers_mm)
        normals = tuple(_normalise(normal) for normal in self.normals)
        normals = normals * count if len(normals) == 1 else normals
        faces = self.faces * count if len(self.faces) == 1 else self.faces
        main_type = MAIN_TYPES[self.main_type]
        subtype = max(0, main_type - layout.SUBTYPE_BELOW_TYPE) if self.subtype is None else self.subtype
        interpreted = {
            "normals": normals,
            "faces": faces,
            "face_normals": tuple(_normalise(normal) for normal in self.face_normals)
            or tuple(_face_normal(normals, faces, face) for face in range(1, max(faces) + 1)),
            "main_type": main_type,
            "subtype": subtype,
            "marker_type": MARKER_TYPES[self.marker_type],
        }
        return ToolDefinition(**{**dict(self), **interpreted})


def read_description(path: Path) -> ToolDescription:
    """Read a tool description; raises NDI-011 listing every mistake."""
    try:
        content = read_toml(path, partial(BAD_TOOL_FILE, action="Correct the description."))
    except OSError as error:
        what = f"cannot read {path}: {error.strerror}"
        raise BAD_TOOL_FILE(what, action="Give the path of a description; ronna-rom make --help.") from error
    if kind := find_other_kind(content, "part_number"):
        raise BAD_TOOL_FILE(
            f"{path.name} is {kind}, not a tool description",
            expected="part_number and markers_mm",
            action="Give the path of a description; ronna-rom show TOOL.rom --toml prints one.",
        )
    try:
        # via JSON: strict types, but lists are accepted for tuples and text for dates
        return ToolDescription.model_validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        mistakes = describe_mistakes(error, ToolDescription)
        raise BAD_TOOL_FILE(
            f"{path.name} has {format_count(len(mistakes), 'mistake')}: " + "; ".join(mistakes),
            action="Correct the description.",
        ) from error


def describe_tool(tool: ToolDefinition) -> dict[str, Any]:
    """Convert a definition to the description from which `make` builds the same tool."""
    return {
        "part_number": tool.part_number,
        "manufacturer": tool.manufacturer,
        "main_type": _type_name(tool.main_type, MAIN_TYPES),
        "subtype": tool.subtype,
        "revision": tool.revision,
        "made_on": tool.made_on,
        "sequence": tool.sequence,
        "markers_mm": [_round_vector(marker) for marker in tool.markers_mm],
        "normals": [_round_vector(normal) for normal in tool.normals],
        "faces": list(tool.faces),
        "face_normals": [_round_vector(normal) for normal in tool.face_normals],
        "maximum_angle_deg": tool.maximum_angle_deg,
        "minimum_markers": tool.minimum_markers,
        "maximum_error_mm": _round_single(tool.maximum_error_mm),
        "minimum_spread_mm": _round_vector(tool.minimum_spread_mm),
        "unique_geometry": tool.unique_geometry,
        "marker_type": _type_name(tool.marker_type, MARKER_TYPES),
    }


def _type_name(code: int, names: dict[str, int]) -> str:
    return next((name for name, known in names.items() if known == code), f"code {code}")


def _round_vector(vector: Vector3) -> list[float]:
    return [_round_single(value) for value in vector]


def _round_single(value: float) -> float:
    """Round to the seven significant digits of single precision, as stored in files."""
    return float(f"{value:.7g}")


def _normalise(vector: Vector3) -> Vector3:
    length = math.hypot(*vector)
    x, y, z = (value / length for value in vector)
    return x, y, z


def _face_normal(normals: tuple[Vector3, ...], faces: tuple[int, ...], face: int) -> Vector3:
    members = [normal for normal, own in zip(normals, faces, strict=True) if own == face]
    x, y, z = (sum(values) for values in zip(*members, strict=True))
    if math.hypot(x, y, z) == 0:
        raise BAD_TOOL_FILE(
            f"the normals of face {face} cancel each other",
            action="Give these markers faces of their own, or give face_normals.",
        )
    return face_normal_of(_normalise((x, y, z)))
