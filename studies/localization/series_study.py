"""Marker spheres inserted into a CT that somebody brings, and localized there.

Bodies of the series itself that pass for markers before any is inserted are counted apart, not as false.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from procedures.imaging import Volume, read_series
from procedures.imaging.dicom.slice_headers import hash_series, read_headers
from ronna_hw.arrays import Array
from studies.campaign.study import Study, Sums, Table, Unit, as_sums, blocks_of_each, generator
from studies.errors import SERIES_WITHOUT_ROOM
from studies.localization.inserted_markers import (
    FLANGE_BELOW_MM,
    FLANGE_LENGTH_MM,
    POSTS,
    InsertedMarker,
    insert_markers,
)
from studies.localization.metal_study import count_spheres, localize_all, tabulate_spheres
from studies.localization.scanner_of_series import SeriesScanner, measure_scanner
from studies.localization.study import SAME_SPHERE_MM

MARKERS = 6  # of one insertion
STANDOFF_MM = (13.0, 16.0)  # from the skin to the middle of a ball
SCREW_MM = 10.0  # of a metal post, below the skin
FREE_MM = 11.0  # around the middle of a ball: its surroundings, which must be air above its base
APART_MM = 35.0
EDGE_MM = 20.0  # from the ends of the field
LEANING = 0.3  # tangent of a post's angle to the normal, at most
POST_RADIUS_MM = {"polymer": (1.4, 2.2), "titanium": (1.4, 2.0), "steel": (1.0, 1.4)}
DENSITY = (0.95, 1.15)
OPEN_SHARE = 0.98  # of the voxels around a ball that must be air
DRAWS = 4000


@dataclass(frozen=True)
class SeriesStudy(Study):
    """Localization of inserted spheres, by number of insertions for each kind of post."""

    series: str
    volumes: int
    seed: int = 0
    name: str = "localization-series"

    constants: ClassVar = {"markers": MARKERS}

    def settings(self) -> dict[str, object]:
        """Return the settings with the series itself, as another may lie at its path the next time."""
        folder = Path(self.series)
        return {
            **super().settings(),
            "series_instance_uid": read_headers(folder)[0].series_instance_uid,
            "series_sha256": hash_series(folder),
        }

    def units(self) -> Sequence[Unit]:
        return blocks_of_each(([post] for post in POSTS), self.volumes, 1)

    def run(self, unit: Unit) -> Sums:
        """Return the counts and sums of squares (mm2) of one insertion."""
        random = generator(self.seed, unit)
        scanner, before = measured_series(self.series)
        markers = place_markers(scanner, unit.condition, random)
        voxels = insert_markers(scanner, markers, random)
        voxels.flags.writeable = False
        volume = replace(scanner.volume, voxels=voxels)
        found, candidates = localize_all(volume)
        centres = volume.geometry.grid_mm_to_patient_mm(np.array([one.centre_mm for one in markers]))
        own = [one for one in found if not _is_near(np.array(one.centre_mm), before)]
        streaked = np.full(len(centres), unit.condition != "polymer")
        sums = count_spheres(own, candidates, centres, streaked)
        return as_sums({**sums, "taken before": len(before)})


@cache
def measured_series(series: str) -> tuple[SeriesScanner, Array]:
    """Read and measure a series once. Return it with what passes for markers in it (n, 3), patient mm."""
    volume = read_series(Path(series))
    scanner = measure_scanner(volume)
    return scanner, _markers_in(volume)


def _markers_in(volume: Volume) -> Array:
    return np.array([one.centre_mm for one in localize_all(volume)[0]]).reshape(-1, 3)


def _is_near(place: Array, places: Array) -> bool:
    return bool((np.linalg.norm(places - place, axis=1) < SAME_SPHERE_MM).any())


def place_markers(scanner: SeriesScanner, post: str, random: np.random.Generator) -> list[InsertedMarker]:
    """Draw markers on the skin with air around them. Raises STU-028 if they do not fit."""
    spacing, shape = scanner.spacing_mm, scanner.volume.voxels.shape
    distance = scanner.skin_distance_mm
    low, high = STANDOFF_MM
    at_height = np.flatnonzero((distance > low) & (distance < high))
    size_mm = np.array(shape) * spacing
    smooth = ndimage.gaussian_filter(distance.astype(np.float32), 3.0 / spacing)
    markers: list[InsertedMarker] = []
    for draw in random.permutation(at_height)[:DRAWS]:
        index = np.array(np.unravel_index(int(draw), shape))
        centre = (index + random.uniform(-0.5, 0.5, 3)) * spacing
        clear_of_ends = ((centre > EDGE_MM) & (centre < size_mm - EDGE_MM)).all()
        apart = all(np.linalg.norm(centre - one.centre_mm) > APART_MM for one in markers)
        if not (clear_of_ends and apart and _is_open(scanner, centre)):
            continue
        inwards = -_slope(smooth, index) / spacing
        inwards += LEANING * random.uniform(-1.0, 1.0, 3) * np.linalg.norm(inwards) / np.sqrt(3.0)
        screw_mm = 0.0 if post == "polymer" else SCREW_MM
        markers.append(
            InsertedMarker(
                centre,
                inwards / np.linalg.norm(inwards),
                post,
                float(random.uniform(*POST_RADIUS_MM[post])),
                FLANGE_BELOW_MM + FLANGE_LENGTH_MM + screw_mm,
                float(random.uniform(*DENSITY)),
            )
        )
        if len(markers) == MARKERS:
            return markers
    raise SERIES_WITHOUT_ROOM(
        "too few places on the skin with air around them",
        expected=f"{MARKERS} places, {APART_MM:g} mm apart and {EDGE_MM:g} mm from the ends of the field",
        got=f"{len(markers)}",
    )


def _slope(distance: NDArray[np.float32], index: NDArray[np.signedinteger]) -> Array:
    low = np.maximum(index - 1, 0)
    high = np.minimum(index + 1, np.array(distance.shape) - 1)
    steps = [(tuple(_moved(index, axis, high)), tuple(_moved(index, axis, low))) for axis in range(3)]
    return np.array([float(distance[up]) - float(distance[down]) for up, down in steps])


def _moved(
    index: NDArray[np.signedinteger], axis: int, ends: NDArray[np.signedinteger]
) -> NDArray[np.signedinteger]:
    moved = index.copy()
    moved[axis] = ends[axis]
    return moved


def _is_open(scanner: SeriesScanner, centre_mm: Array) -> bool:
    """Return whether the surroundings of a ball are air, so that nothing overlaps it."""
    spacing = scanner.spacing_mm
    low = np.maximum(np.floor((centre_mm - FREE_MM) / spacing).astype(int), 0)
    high = np.ceil((centre_mm + FREE_MM) / spacing).astype(int) + 1
    box = tuple(slice(start, end) for start, end in zip(low, high, strict=True))
    z, y, x = np.ogrid[box]
    squares = sum(((axis * s - c) ** 2 for axis, s, c in zip((z, y, x), spacing, centre_mm, strict=True)))
    open_air = scanner.is_open_air[box]
    around = np.asarray(squares < FREE_MM**2)[: open_air.shape[0], : open_air.shape[1], : open_air.shape[2]]
    return float(open_air[around].mean()) >= OPEN_SHARE


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate the results by post and together, and compare them with the goals."""
    before = max(
        (int(one.get("taken before", 0.0) / max(one["volumes"], 1.0)) for one in sums.values()), default=0
    )
    note = f"Places of the series itself that pass for markers: {before}; they are not counted as false."
    return tabulate_spheres(
        "Spheres inserted into a series", "post", "Metal posts make the streaks. " + note, sums
    )
