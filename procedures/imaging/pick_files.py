"""Reads points: CSV rows, a JSON list, output of `ronna-ct`, or a 3D Slicer point list (`.mrk.json`)."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.errors import PicksUnreadable
from ronna_hw.bounded_input import InputRefused, parse_json, read_bounded
from ronna_hw.plausible import FARTHEST_MM

Array = NDArray[np.float64]

LARGEST_FILE_BYTES = 1_000_000  # a 3D Slicer point list takes a kilobyte per point
COLUMNS = ("L_mm", "P_mm", "S_mm")  # as `--write FILE.csv` names them
OWN_LISTS = ("spheres", "markers", "candidates")  # as `--write FILE.json` and `--json` name them
LONGEST_QUOTE = 60  # characters quoted from a rejected line
EXPECTED = "a list of points, or the point lists of 3D Slicer"
LPS_FROM_RAS = np.array([-1.0, -1.0, 1.0])


def read_picks(path: Path) -> Array:
    """Picks (n, 3) LPS mm from a .csv or .json file; raises CT-018."""
    try:
        content = read_bounded(path, LARGEST_FILE_BYTES)
    except OSError as error:
        raise PicksUnreadable(f"cannot read {path.name}: {error.strerror}") from error
    except InputRefused as error:
        raise PicksUnreadable(f"{path.name} is refused: {error.summary}") from error
    return parse_points(content, path.name)


def parse_points(content: bytes, name: str) -> Array:
    """Points (n, 3) LPS mm, n > 0, from the content of a file with this name; raises CT-018."""
    try:
        is_json = name.lower().endswith(".json")
        rows = _from_json(parse_json(content)) if is_json else _from_csv(content.decode("utf-8-sig"), name)
        points = np.array(rows, dtype=float)
    except PicksUnreadable:
        raise
    except InputRefused as error:
        raise PicksUnreadable(f"{name} is refused: {error.summary}") from error
    except LookupError as error:
        raise PicksUnreadable(f"{name} has no points: it has no {error}") from error
    except (TypeError, AttributeError) as error:  # values of other kinds, in other places
        raise PicksUnreadable(f"{name} has no points where they belong", expected=EXPECTED) from error
    except (ValueError, csv.Error) as error:
        raise PicksUnreadable(f"{name} has no points: {error}") from error
    if points.ndim != 2 or points.shape[1] != 3 or not (np.abs(points) <= FARTHEST_MM).all():
        expected = f"three finite numbers for each, of at most {FARTHEST_MM:g} mm"
        raise PicksUnreadable(f"{name} has no points", expected=expected)
    return points


def _from_csv(text: str, name: str) -> list[list[float]]:
    """Three columns, or those named L_mm, P_mm, S_mm if there is a header, separated by , or ;

    Any other header is refused: it may mean other axes.
    """
    lines = text.splitlines()
    first = next((line for line in lines if line and not line.startswith("#")), "")
    reader = csv.reader(lines, delimiter=";" if ";" in first else ",")
    places: list[int] | None = None
    picks: list[list[float]] = []
    for row in reader:
        if not row or row[0].startswith("#"):
            continue
        cells = [cell.strip() for cell in row]
        if places is None and not picks and set(COLUMNS) <= set(cells):
            places = [cells.index(column) for column in COLUMNS]
            continue
        try:
            left_mm, posterior_mm, superior_mm = cells if places is None else [cells[at] for at in places]
            picks.append([float(left_mm), float(posterior_mm), float(superior_mm)])
        except (ValueError, IndexError):
            raise PicksUnreadable(
                f"{name}, line {reader.line_num} is not a point",
                expected=f"three numbers with , or ; between them, or first a header {','.join(COLUMNS)}",
                got=repr(" ".join(row)[:LONGEST_QUOTE]),
            ) from None
    return picks


def _from_json(content: Any) -> list[Any]:
    if isinstance(content, list):
        return content
    for name in OWN_LISTS:
        if name in content:
            return [one["centre_mm"] for one in content[name]]
    picks: list[Any] = []
    for markup in content["markups"]:
        system = str(markup.get("coordinateSystem", "LPS")).upper()
        if system not in ("LPS", "RAS"):
            raise ValueError(f"unknown coordinate system {system}")
        turn = LPS_FROM_RAS if system == "RAS" else np.ones(3)
        picks += [
            (turn * np.array(point["position"], dtype=float)).tolist() for point in markup["controlPoints"]
        ]
    return picks
