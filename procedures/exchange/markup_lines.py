"""Trajectories drawn in 3D Slicer: its line markups `.mrk.json` to entry and target in the CT (LPS, mm).

A markup does not say which of its ends is the target. Labels may, as those of an export do; otherwise the
person who drew the lines states their order. Nothing is guessed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from procedures.exchange.errors import MARKUP_ENDS, MARKUP_OF_ANOTHER_FRAME, MARKUP_UNREADABLE
from procedures.exchange.export_tables import LPS, MILLIMETRE
from procedures.exchange.line_order import LineOrder
from procedures.exchange.slicer_markups import Point
from ronna_hw.bounded_input import InputRefused, parse_json, read_bounded
from ronna_hw.plausible import FARTHEST_MM, LONGEST_NAME, NAME_PATTERN
from ronna_hw.text import printable

LONGEST_UID = 64  # of DICOM
LARGEST_FILE_BYTES = 1_000_000  # a line takes two kilobytes
RAS = "RAS"
SIGNS = {LPS: (1.0, 1.0, 1.0), RAS: (-1.0, -1.0, 1.0)}
UNITS = (MILLIMETRE, [MILLIMETRE] * 3)  # as a word, or for each axis
FRAME_KEY = "frame_of_reference_uid"  # of files of our exports
LINE, DEFINED = "Line", "defined"
PLANNED_ENDING = " planned"  # of the name of a line in an export
ENTRY_WORD, TARGET_WORD = re.compile(r"\bentry\b", re.I), re.compile(r"\b(target|tip)\b", re.I)
LONGEST_QUOTE = 40  # characters


@dataclass(frozen=True)
class MarkupLine:
    """Line of a trajectory, in the LPS mm of the series on which it was drawn.

    Only if `is_frame_stated` its file says on which, as Slicer's own do not.
    """

    name: str
    entry_mm: Point
    target_mm: Point
    is_frame_stated: bool = False


def read_lines(path: Path, frame_of_reference_uid: str, order: LineOrder | None) -> tuple[MarkupLine, ...]:
    """Read the lines of a markups file drawn in this frame of reference. Raises MRK-001 to MRK-003.

    `order` serves lines whose labels do not name entry and target; it may not contradict those that do.
    """
    try:
        content = parse_json(read_bounded(path, LARGEST_FILE_BYTES))
    except OSError as error:
        raise MARKUP_UNREADABLE(f"cannot read {path}: {error.strerror}") from error
    except InputRefused as error:
        raise MARKUP_UNREADABLE(f"{path.name} is refused: {error.summary}") from error
    except ValueError as error:
        raise MARKUP_UNREADABLE(f"{path.name} is no file of markups: {error}") from error
    markups = content.get("markups") if isinstance(content, dict) else None
    if not isinstance(markups, list) or not markups or not all(isinstance(one, dict) for one in markups):
        raise MARKUP_UNREADABLE(f"{path.name} has no markups", expected="a .mrk.json that 3D Slicer saved")
    _require_frame(content, path.name, frame_of_reference_uid)
    lines = (_read_line(one, f"{path.name}, {_quote(one.get('name'))}", order) for one in markups)
    return tuple(replace(one, is_frame_stated=FRAME_KEY in content) for one in lines)


def _require_frame(content: dict[str, Any], name: str, frame_of_reference_uid: str) -> None:
    """Raise MRK-002 if a file that names its frame, as ours do and Slicer's do not, names another one."""
    if FRAME_KEY in content and (stated := content[FRAME_KEY]) != frame_of_reference_uid:
        raise MARKUP_OF_ANOTHER_FRAME(
            f"{name} is of another frame of reference",
            expected=frame_of_reference_uid,
            got=printable(str(stated))[:LONGEST_UID],
            action="With --fusion, --points-in says on which series it was drawn; without, draw it on the "
            "CT of the plan.",
        )


def _read_line(markup: dict[str, Any], where: str, order: LineOrder | None) -> MarkupLine:
    if markup.get("type") != LINE:
        raise MARKUP_UNREADABLE(f"{where} is no line", expected=LINE, got=_quote(markup.get("type")))
    system = markup.get("coordinateSystem")
    signs = SIGNS.get(system) if isinstance(system, str) else None
    if signs is None:
        raise MARKUP_OF_ANOTHER_FRAME(
            f"{where} is in an unknown coordinate system", expected=" or ".join(SIGNS), got=_quote(system)
        )
    if (unit := markup.get("coordinateUnits", MILLIMETRE)) not in UNITS:  # older Slicers: always mm
        raise MARKUP_OF_ANOTHER_FRAME(f"{where} is in another unit", expected=MILLIMETRE, got=_quote(unit))
    points = markup.get("controlPoints")
    if not isinstance(points, list) or len(points) != 2 or not all(isinstance(one, dict) for one in points):
        got = str(len(points)) if isinstance(points, list) else "none"
        raise MARKUP_UNREADABLE(f"{where} is not a line of two points", expected="2 points", got=got)
    first, second = (_read_point(one, where, signs) for one in points)
    is_entry_first = _is_entry_first([str(one.get("label", "")) for one in points], where, order)
    entry, target = (first, second) if is_entry_first else (second, first)
    return MarkupLine(_read_name(markup, where), entry, target)


def _read_point(point: dict[str, Any], where: str, signs: Point) -> Point:
    status, position = point.get("positionStatus", DEFINED), point.get("position")
    if status != DEFINED:
        raise MARKUP_UNREADABLE(
            f"{where} has a point that was not placed", expected=DEFINED, got=_quote(status)
        )
    if not (
        isinstance(position, list) and len(position) == len(signs) and all(map(_is_coordinate, position))
    ):
        raise MARKUP_UNREADABLE(
            f"{where} has a point without a position", expected="three numbers", got=_quote(position)
        )
    x, y, z = (float(value) * sign for value, sign in zip(position, signs, strict=True))
    return x, y, z


def _is_coordinate(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return -FARTHEST_MM <= value <= FARTHEST_MM


def _is_entry_first(labels: list[str], where: str, order: LineOrder | None) -> bool:
    """Decide by the labels, or else by the stated order, which end is the entry. Raises MRK-003."""
    entries = [bool(ENTRY_WORD.search(label)) for label in labels]
    targets = [bool(TARGET_WORD.search(label)) for label in labels]
    shown = " and ".join(map(_quote, labels))
    by_label: LineOrder | None = None
    if any(entries) or any(targets):
        is_first = entries[0] or targets[1]
        if is_first == (entries[1] or targets[0]):
            raise MARKUP_ENDS(f"{where}: its labels contradict each other", got=shown)
        by_label = LineOrder.ENTRY_FIRST if is_first else LineOrder.TARGET_FIRST
    if by_label is not None and order is not None and by_label is not order:
        raise MARKUP_ENDS(f"{where}: its labels contradict --order {order}", got=shown)
    if (decided := by_label or order) is None:
        raise MARKUP_ENDS(
            f"{where} does not say which end is the target",
            expected="labels with the words entry and target, or --order",
            got=shown,
        )
    return decided is LineOrder.ENTRY_FIRST


def _read_name(markup: dict[str, Any], where: str) -> str:
    name = str(markup.get("name", "")).removesuffix(PLANNED_ENDING)
    if not re.fullmatch(NAME_PATTERN, name) or len(name) > LONGEST_NAME:
        raise MARKUP_UNREADABLE(
            f"{where}: its name cannot be that of a trajectory",
            expected=f"at most {LONGEST_NAME} letters, digits and . _ - without blanks",
            got=_quote(name),
            action="Rename the line in 3D Slicer, such as T1, and save it again.",
        )
    return name


def _quote(value: object) -> str:
    return "none" if value is None else repr(printable(str(value))[:LONGEST_QUOTE])
