"""Objects that resemble spheres (rod ends, beads, domes, hollow balls) among markers in phantom scans.

Scans are painted in memory. The localizer gets no hints: missed markers and false ones
count, as does the separation of their odds. Families without look-alikes are painted whole, the others in
the box around markers and objects.

    python -m benchmarks.scans.look_alikes --volumes 26 --seed 7000
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from procedures.imaging import Candidate, Localization, Volume, VoxelGeometry, localize
from procedures.imaging.errors import MarkerCountWrong
from ronna_hw.arrays import Array
from sim.phantom.families.catalogue import FAMILIES, PROTOCOLS, Purpose
from sim.phantom.families.family_scan import family_scan
from sim.phantom.scan import Planes, Scan
from sim.phantom.scanner.dicom_series import INTERCEPT_HU, to_stored_values
from sim.phantom.scanner.grid import CtGrid
from sim.world.rigid import Point

MARGINS_MM = (16.0, 16.0, 16.0)  # around markers and objects, along L, P and S
WHOLE_SLICES_MM, WHOLE_MM = (1e3, 1e3, 16.0), (1e3, 1e3, 1e3)
SAME_SPHERE_MM = 2.0
CHI2_99 = 11.34  # with three degrees of freedom
ORIGIN_DIGITS = 4


@dataclass(frozen=True, eq=False)
class Painted:
    """A volume with its ground truth: marker centres (n, 3) in LPS mm, and the positions of each object.

    Markers that the field of view cuts count neither as missed nor as false.
    """

    volume: Volume
    centres_mm: Array
    cut_mm: Array
    objects: tuple[tuple[str, Array], ...]


@dataclass
class Count:
    volumes: int = 0
    markers: int = 0
    missed: int = 0
    objects: int = 0
    false: int = 0
    kinds: Counter[str] = field(default_factory=Counter)  # of the false ones
    squared_mm2: float = 0.0
    largest_mm: float = 0.0
    chi2: list[float] = field(default_factory=list)  # of the markers found
    lost: list[str] = field(default_factory=list)  # reasons for the missed ones
    least_true: float = 1.0  # odds of markers
    most_other: float = 0.0  # odds of everything else

    @property
    def rms_um(self) -> float:
        return 1e3 * float(np.sqrt(self.squared_mm2 / max(len(self.chi2), 1)))

    def add(self, found: Localization | None, candidates: tuple[Candidate, ...], painted: Painted) -> None:
        self.volumes += 1
        self.markers += len(painted.centres_mm)
        self.objects += len(painted.objects)
        centres_mm = np.empty((0, 3)) if found is None else found.centres_mm
        distance = np.linalg.norm(painted.centres_mm[:, None] - centres_mm[None], axis=2)
        near = distance < SAME_SPHERE_MM
        for sphere, centre_mm in enumerate(painted.centres_mm):
            if found is None or not near[sphere].any():
                self.missed += 1
                self.lost += [one.reason for one in candidates if _is_near(one.centre_mm, centre_mm[None])]
                continue
            marker = found.markers[int(distance[sphere].argmin())]
            error_mm = marker.centre_mm - centre_mm
            self.squared_mm2 += float(error_mm @ error_mm)
            self.largest_mm = max(self.largest_mm, float(np.linalg.norm(error_mm)))
            self.chi2.append(float(error_mm @ np.linalg.solve(marker.covariance_mm2, error_mm)))
        for candidate in candidates:
            if _is_near(candidate.centre_mm, painted.centres_mm):
                self.least_true = min(self.least_true, candidate.odds or 1.0)
            elif not _is_near(candidate.centre_mm, painted.cut_mm):
                self.most_other = max(self.most_other, candidate.odds)
        for centre_mm in centres_mm[~near.any(axis=0)]:
            if not _is_near(centre_mm, painted.cut_mm):
                self.false += 1
                self.kinds[_nearest_kind(centre_mm, painted)] += 1


def paint(scan: Scan, margins_mm: Point = MARGINS_MM) -> Painted:
    """Paint a scan, cropped to the box around its markers and objects."""
    places = np.array(scan.anatomy.places)
    grid = _crop_grid(scan.grid, places.min(axis=0) - margins_mm, places.max(axis=0) + margins_mm)
    slices = Planes(replace(scan, grid=grid))
    with ThreadPoolExecutor(1) as pool:
        slices.paint_patches(pool)
    planes = [
        to_stored_values(slices.paint(number), slices.largest_stored).astype(np.int16)
        for number in range(grid.slices)
    ]
    x, y, z = grid.origin_mm
    geometry = VoxelGeometry(
        (grid.slices, grid.rows, grid.columns),
        np.array([x, y, z]),
        np.eye(3)[:, ::-1],
        np.array([grid.slice_mm, grid.pixel_mm, grid.pixel_mm]),
    )
    objects = [(one["kind"], np.array(one["places_mm"])) for one in scan.truth.get("look_alikes", ())]
    objects += [("distractor", np.array([place])) for place in scan.truth.get("distractors_mm", ())]
    volume = Volume(np.stack(planes) + np.int16(INTERCEPT_HU), geometry, "1.2.3", "1.2.4")
    shares = [scan.marks.get(one.fiducial.number, {}) for one in scan.anatomy.markers]
    whole = np.array([one.get("surface_in_field", 1.0) == 1.0 for one in shares])
    centres_mm = places[: len(whole)]
    return Painted(volume, centres_mm[whole], centres_mm[~whole], tuple(objects))


def judge(painted: Painted, count: Count) -> None:
    try:
        found = localize(painted.volume)
        count.add(found, found.candidates, painted)
    except MarkerCountWrong as error:
        count.add(None, error.candidates, painted)


def scans(family: str, protocol: str, volumes: int, seed: int) -> Iterator[Scan]:
    """Yield the family's scans for a protocol, assigning volumes to the protocols in rotation."""
    protocols = list(PROTOCOLS)
    for number in range(protocols.index(protocol), volumes, len(protocols)):
        yield family_scan(family, protocol, seed=seed + number)


def _crop_grid(grid: CtGrid, low_mm: Array, high_mm: Array) -> CtGrid:
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


def _is_near(place_mm: ArrayLike, centres_mm: Array) -> bool:
    return bool((np.linalg.norm(centres_mm - np.asarray(place_mm), axis=1) < SAME_SPHERE_MM).any())


def _nearest_kind(centre_mm: Array, painted: Painted) -> str:
    distances = {
        f"{kind} {number}": float(np.linalg.norm(places - centre_mm, axis=1).min())
        for number, (kind, places) in enumerate(painted.objects)
    }
    nearest = min(distances, key=lambda name: distances[name], default="other 0")
    return nearest.rpartition(" ")[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    judging = [name for name, one in FAMILIES.items() if one.look_alikes and one.purpose is Purpose.JUDGING]
    parser.add_argument("families", nargs="*", default=judging)
    parser.add_argument("--volumes", type=int, default=26, help="of each family, protocols in turn")
    parser.add_argument("--seed", type=int, default=7000)
    arguments = parser.parse_args()
    print(
        "family      protocol volumes markers missed objects false  rms  max µm chi²/3n >99 %"
        "  odds: markers, others  taken for markers; why missed"
    )
    for family in arguments.families:
        for protocol in PROTOCOLS:
            count = Count()
            for scan in scans(family, protocol, arguments.volumes, arguments.seed):
                judge(paint(scan, MARGINS_MM if FAMILIES[family].look_alikes else WHOLE_MM), count)
            if count.volumes:
                print(_format_line(family, protocol, count), flush=True)


def _format_line(family: str, protocol: str, count: Count) -> str:
    kinds = ", ".join(f"{number} {kind}" for kind, number in count.kinds.most_common())
    chi2 = sum(count.chi2) / (3.0 * max(len(count.chi2), 1))
    beyond_99 = sum(one > CHI2_99 for one in count.chi2)
    return (
        f"{family:<12}{protocol:<8}{count.volumes:8}{count.markers:8}{count.missed:7}{count.objects:8}"
        f"{count.false:6}{count.rms_um:6.1f}{1e3 * count.largest_mm:7.1f}{chi2:8.2f}{beyond_99:6}"
        f"{count.least_true:15.3f}{count.most_other:8.3f}  {kinds}; {', '.join(count.lost)}"
    )


if __name__ == "__main__":
    main()
