"""Look-alikes of spheres: round ends of rods, beads, domes, hollow balls next to markers in phantom scans.

Scans are painted in memory, cropped to the box around markers and objects. The localizer gets no hints:
missed markers and objects taken for markers count, as does the separation of their odds.

    python -m benchmarks.scans.look_alikes --volumes 26 --seed 7000
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from procedures.imaging import Candidate, Localization, Volume, VoxelGeometry, localize
from procedures.imaging.errors import MarkerCountWrong
from sim.phantom.families.catalogue import FAMILIES, PROTOCOLS, Purpose
from sim.phantom.families.drawn_scan import family_scan
from sim.phantom.scan import Scan
from sim.phantom.scanner.dicom_series import INTERCEPT_HU, stored_values
from sim.phantom.scanner.grid import CtGrid
from sim.phantom.scanner.planes import Planes

Array = NDArray[np.float64]

MARGIN_MM = 16.0  # around markers and objects
SAME_SPHERE_MM = 2.0
ORIGIN_DIGITS = 4


@dataclass(frozen=True, eq=False)
class Painted:
    """A volume with the truth: centres of the markers (n, 3) LPS mm, and the positions of each object."""

    volume: Volume
    centres_mm: Array
    objects: tuple[tuple[str, Array], ...]


@dataclass
class Count:
    """Outcomes for markers and objects."""

    volumes: int = 0
    markers: int = 0
    missed: int = 0
    objects: int = 0
    false: int = 0
    kinds: Counter[str] = field(default_factory=Counter)  # of the false ones
    squared_mm2: float = 0.0
    least_true: float = 1.0  # odds of markers
    most_other: float = 0.0  # odds of everything else

    @property
    def rms_um(self) -> float:
        """3-D error of the markers found."""
        return 1e3 * float(np.sqrt(self.squared_mm2 / max(self.markers - self.missed, 1)))

    def add(self, found: Localization | None, candidates: tuple[Candidate, ...], painted: Painted) -> None:
        """Compare one localization with the truth."""
        self.volumes += 1
        self.markers += len(painted.centres_mm)
        self.objects += len(painted.objects)
        centres_mm = np.empty((0, 3)) if found is None else found.centres_mm
        distance = np.linalg.norm(painted.centres_mm[:, None] - centres_mm[None], axis=2)
        near = distance < SAME_SPHERE_MM
        self.missed += int((~near.any(axis=1)).sum())
        self.squared_mm2 += float((distance[near] ** 2).sum())
        for candidate in candidates:
            to_truth_mm = np.linalg.norm(painted.centres_mm - candidate.centre_mm, axis=1).min()
            if to_truth_mm < SAME_SPHERE_MM and candidate.odds > 0.0:
                self.least_true = min(self.least_true, candidate.odds)
            elif to_truth_mm >= SAME_SPHERE_MM:
                self.most_other = max(self.most_other, candidate.odds)
        for centre_mm in centres_mm[~near.any(axis=0)]:
            self.false += 1
            self.kinds[_nearest_kind(centre_mm, painted)] += 1


def paint(scan: Scan, *, whole_slices: bool = False) -> Painted:
    """Paint a scan of a family within the box around its markers and objects, or their complete slices."""
    places = np.array(scan.anatomy.places)
    margin_mm = np.array([1e3, 1e3, MARGIN_MM] if whole_slices else [MARGIN_MM] * 3)
    grid = _cropped(scan.grid, places.min(axis=0) - margin_mm, places.max(axis=0) + margin_mm)
    slices = Planes(replace(scan, grid=grid))
    with ThreadPoolExecutor(1) as pool:
        slices.paint_patches(pool)
    planes = [
        stored_values(slices.paint(number), slices.largest_stored).astype(np.int16)
        for number in range(grid.slices)
    ]
    x, y, z = grid.origin_mm
    geometry = VoxelGeometry(
        (grid.slices, grid.rows, grid.columns),
        np.array([x, y, z]),
        np.eye(3)[:, ::-1],
        np.array([grid.slice_mm, grid.pixel_mm, grid.pixel_mm]),
    )
    objects = tuple((one["kind"], np.array(one["places_mm"])) for one in scan.truth.get("look_alikes", ()))
    volume = Volume(np.stack(planes) + np.int16(INTERCEPT_HU), geometry, "1.2.3", "1.2.4")
    return Painted(volume, places[: len(scan.anatomy.markers)], objects)


def judge(painted: Painted, count: Count) -> None:
    """Localize without the expected count."""
    try:
        found = localize(painted.volume)
        count.add(found, found.candidates, painted)
    except MarkerCountWrong as error:
        count.add(None, error.candidates, painted)


def scans(family: str, volumes: int, seed: int) -> Iterator[Scan]:
    """Scans of a family, with alternating protocols."""
    protocols = list(PROTOCOLS)
    for number in range(volumes):
        yield family_scan(family, protocols[number % len(protocols)], seed=seed + number)


def _cropped(grid: CtGrid, low_mm: Array, high_mm: Array) -> CtGrid:
    x, y, z = (grid.indices(axis, float(low_mm[axis]), float(high_mm[axis])) for axis in range(3))
    origin = [
        round(first + part.start * step, ORIGIN_DIGITS)
        for first, part, step in zip(
            grid.origin_mm, (x, y, z), (grid.pixel_mm, grid.pixel_mm, grid.slice_mm), strict=True
        )
    ]
    return replace(
        grid,
        origin_mm=(origin[0], origin[1], origin[2]),
        columns=x.stop - x.start,
        rows=y.stop - y.start,
        slices=z.stop - z.start,
    )


def _nearest_kind(centre_mm: Array, painted: Painted) -> str:
    distances = {
        f"{kind} {number}": float(np.linalg.norm(places - centre_mm, axis=1).min())
        for number, (kind, places) in enumerate(painted.objects)
    }
    nearest = min(distances, key=lambda name: distances[name], default="other 0")
    return nearest.rpartition(" ")[0]


def main() -> None:
    """Print one line per family."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    judging = [name for name, one in FAMILIES.items() if one.look_alikes and one.purpose is Purpose.JUDGING]
    parser.add_argument("families", nargs="*", default=judging)
    parser.add_argument("--volumes", type=int, default=26, help="of each family")
    parser.add_argument("--seed", type=int, default=7000)
    arguments = parser.parse_args()
    print(
        "family      volumes markers missed objects false  rms µm  odds: markers, others  taken for markers"
    )
    for family in arguments.families:
        count = Count()
        for scan in scans(family, arguments.volumes, arguments.seed):
            judge(paint(scan), count)
        kinds = ", ".join(f"{number} {kind}" for kind, number in count.kinds.most_common())
        print(
            f"{family:<12}{count.volumes:6}{count.markers:8}{count.missed:7}{count.objects:8}{count.false:6}"
            f"{count.rms_um:8.1f}{count.least_true:15.3f}{count.most_other:8.3f}  {kinds}",
            flush=True,
        )


if __name__ == "__main__":
    main()
