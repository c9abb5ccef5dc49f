"""Manual fallback: a person picks approximate sphere centres, which are then measured as usual.

A pick replaces detection, and a marker at a pick may show less of its surface than a detected one, or be
doubtful. It never replaces the measurement: a pick without a sphere is refused with the reason. Picks come
from CSV rows, a JSON list, output of `ronna-ct`, or a 3D Slicer point list (`.mrk.json`).
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from procedures.imaging.errors import PickRefused, PicksUnreadable
from procedures.imaging.examination import Sphere, as_candidate, as_marker, examine_place, judge_shape
from procedures.imaging.localization import (
    DIAMETER_MM,
    check_request,
    combine_markers,
    find_peaks,
    judge_spheres,
    require_count,
    superior_first_key,
)
from procedures.imaging.markers import Candidate, Localization
from procedures.imaging.volume import Volume, cube_around
from ronna_hw.arguments import require_path
from ronna_hw.arrays import Array
from ronna_hw.bounded_input import InputRefused, parse_json, read_bounded
from ronna_hw.plausible import FARTHEST_MM

LARGEST_FILE_BYTES = 1_000_000  # a 3D Slicer point list takes a kilobyte per point
COLUMNS = ("L_mm", "P_mm", "S_mm")  # as `--write FILE.csv` names them
OWN_LISTS = ("spheres", "markers", "candidates")  # as `--write FILE.json` and `--json` name them
LONGEST_QUOTE = 60  # characters quoted from a rejected line
EXPECTED = "a list of points, or the point lists of 3D Slicer"
LPS_FROM_RAS = np.array([-1.0, -1.0, 1.0])

PICK_TOLERANCE = 1.0  # of the radius: a sphere's centre may be this far from its pick
CROP = 3.2  # of the radius: the neighbourhood that is searched
MIN_SURFACE_SHARE = 0.3
IN_RAS = (
    "It would be on a sphere in RAS, as shown by 3D Slicer: change the signs of the first two numbers, "
    "or give its .mrk.json, which states its coordinate system."
)
IN_METRES = "It would be on a sphere in metres: give millimetres."
START_STEP = 0.4  # of the radius, between starts around a pick without contrast


def localize_picks(
    volume: Volume,
    picks_mm: ArrayLike,
    *,
    diameter_mm: float = DIAMETER_MM,
    expected: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Localization:
    """Localize a sphere of `diameter_mm` at each pick (n, 3) LPS mm; flag every marker `picked`.

    Raises CT-019 for a pick without a sphere, outside the volume or on a sphere picked before; CT-016 and
    CT-017 like `localize`.
    """
    picks = np.asarray(picks_mm, dtype=float)
    check_request(volume, diameter_mm, expected)
    if picks.ndim != 2 or picks.shape[1] != 3 or not np.isfinite(picks).all():
        raise PickRefused("picks are rows of three finite numbers", got=f"shape {picks.shape}")
    radius_mm = 0.5 * diameter_mm
    found: list[Sphere] = []
    for number, pick_mm in enumerate(picks, start=1):
        found.append(judge_shape(_measure_pick(volume, number, pick_mm, radius_mm, found), volume, radius_mm))
        progress(number / len(picks))
    found = [
        replace(sphere, picked=True) for sphere in judge_spheres(found, (), volume.geometry, diameter_mm)
    ]
    candidates = tuple(as_candidate(sphere, volume) for sphere in found)
    require_count(len(found), expected, candidates, diameter_mm)
    markers = (as_marker(sphere, found, volume, radius_mm) for sphere in found)
    in_order = sorted(markers, key=lambda marker: superior_first_key(marker.centre_mm))
    return combine_markers(volume, diameter_mm, found, in_order, candidates)


def _measure_pick(
    volume: Volume, number: int, pick_mm: Array, radius_mm: float, known: list[Sphere]
) -> Sphere:
    """Measure the sphere at a pick. Raises CT-019 if none is found, with a hint for RAS or metres."""
    try:
        return _measure_at(volume, number, pick_mm, radius_mm, known)
    except PickRefused as refused:
        for other_mm, hint in ((LPS_FROM_RAS * pick_mm, IN_RAS), (1e3 * pick_mm, IN_METRES)):
            try:
                _measure_at(volume, number, other_mm, radius_mm, [])
            except PickRefused:
                continue
            raise refused.reworded(refused.what, expected=refused.expected, action=hint) from refused
        raise


def _measure_at(volume: Volume, number: int, pick_mm: Array, radius_mm: float, known: list[Sphere]) -> Sphere:
    geometry = volume.geometry
    place = f"pick {number} at ({', '.join(f'{value:g}' for value in pick_mm)}) mm"
    if not geometry.contains(pick_mm):
        ends = zip("LPS", *geometry.ends_mm, strict=True)
        extent = ", ".join(f"{axis} {low:.0f} to {high:.0f}" for axis, low, high in ends)
        raise PickRefused(f"{place} is outside the scanned volume", expected=f"{extent} mm")
    grid_mm = geometry.to_index(pick_mm) * geometry.spacing_mm
    refused: list[Candidate] = []
    for place_mm, contrast_hu in _list_starts(volume, grid_mm, radius_mm):
        outcome = examine_place(
            volume, place_mm, contrast_hu, radius_mm, known, min_surface_share=MIN_SURFACE_SHARE
        )
        if not isinstance(outcome, Sphere):
            refused.append(outcome)
        elif np.linalg.norm(outcome.centre_mm - grid_mm) <= PICK_TOLERANCE * radius_mm:
            return outcome
    reason = "no sphere within reach"
    if refused:
        reason = max(refused, key=lambda one: one.surface_share or 0.0).reason
    raise PickRefused(f"{place} {reason}")


def _list_starts(volume: Volume, grid_mm: Array, radius_mm: float) -> list[tuple[Array, float]]:
    """List starting points: nearby peaks of the sphere filter, then the pick and points around it."""
    part, offset_mm = _crop(volume, grid_mm, CROP * radius_mm)
    peaks = [
        (place_mm + offset_mm, contrast_hu)
        for place_mm, contrast_hu in find_peaks(part, radius_mm)
        if np.linalg.norm(place_mm + offset_mm - grid_mm) <= PICK_TOLERANCE * radius_mm
    ]
    shifts = sorted(product((0.0, -1.0, 1.0), repeat=3), key=lambda shift: sum(map(abs, shift)))
    around = [(grid_mm + START_STEP * radius_mm * np.array(shift), 0.0) for shift in shifts]
    return peaks + around


def _crop(volume: Volume, grid_mm: Array, half_width_mm: float) -> tuple[Volume, Array]:
    geometry = volume.geometry
    cube = cube_around(geometry, grid_mm, half_width_mm)
    low = np.array([part.start for part in cube])
    voxels = volume.voxels[cube]
    part = replace(geometry, shape=voxels.shape, origin_mm=geometry.to_patient_mm(low))
    return replace(volume, voxels=voxels, geometry=part), low * geometry.spacing_mm


def read_picks(path: str | os.PathLike[str]) -> Array:
    """Read picks (n, 3) LPS mm from a .csv or .json file. Raises CT-018, ARG-001."""
    path = require_path(path, "the file of picks")
    try:
        content = read_bounded(path, LARGEST_FILE_BYTES)
    except OSError as error:
        raise PicksUnreadable(f"cannot read {path.name}: {error.strerror}") from error
    except InputRefused as error:
        raise PicksUnreadable(f"{path.name} is refused: {error.summary}") from error
    return parse_points(content, path.name)


def parse_points(content: bytes, name: str) -> Array:
    """Parse a point file's content into points (n, 3) LPS mm, n > 0. Raises CT-018."""
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
    """Parse three columns separated by , or ;, selected by L_mm, P_mm, S_mm if there is a header.

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
            left_mm, posterior_mm, superior_mm = (
                cells if places is None else [cells[cell_number] for cell_number in places]
            )
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
