"""Read picks: CSV rows, a JSON list, what `ronna-ct` wrote, or a point list of 3D Slicer (`.mrk.json`)."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.errors import PicksUnreadable
from ronna_hw.bounded_input import InputRefused, parse_json, read_bounded

Array = NDArray[np.float64]

LARGEST_FILE_BYTES = 1_000_000  # a point list of 3D Slicer takes a kilobyte per point
COLUMNS = ("L_mm", "P_mm", "S_mm")  # as `--write FILE.csv` names them
OWN_LISTS = ("spheres", "markers", "candidates")  # as `--write FILE.json` and `--json` name them
LPS_FROM_RAS = np.array([-1.0, -1.0, 1.0])


def read_picks(path: Path) -> Array:
    """Picks (n, 3) LPS mm from a .csv or .json file; raises CT-018."""
    try:
        content = read_bounded(path, LARGEST_FILE_BYTES)
        is_json = path.suffix.lower() == ".json"
        rows = _from_json(parse_json(content)) if is_json else _from_csv(content.decode())
        picks = np.array(rows, dtype=float)
    except OSError as error:
        raise PicksUnreadable(f"cannot read the picks in {path.name}: {error.strerror}") from error
    except InputRefused as error:
        raise PicksUnreadable(f"{path.name} is refused: {error.summary}") from error
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise PicksUnreadable(f"{path.name} holds no picks: {error}") from error
    if picks.ndim != 2 or picks.shape[1] != 3 or not np.isfinite(picks).all():
        raise PicksUnreadable(f"{path.name} holds no picks", expected="three finite numbers per pick")
    return picks


def _from_csv(text: str) -> list[list[float]]:
    """Three columns, or those named L_mm, P_mm, S_mm when there is a header."""
    rows = [row for row in csv.reader(text.splitlines()) if row and not row[0].startswith("#")]
    if rows and set(COLUMNS) <= {cell.strip() for cell in rows[0]}:
        names = [cell.strip() for cell in rows[0]]
        places = [names.index(column) for column in COLUMNS]
        return [[float(row[place]) for place in places] for row in rows[1:]]
    return [[float(cell) for cell in row] for row in rows]


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
