"""The thesis' localization protocol: 12 scans of patients and 8 of a phantom, 116 spheres, one frame in each.

Phantoms stand in for both. The number of spheres implies that some scans contain more than the frame's four;
their distribution is our choice, and the frame is the close one. Every scan has its own scale error, as with
a real scanner; the spheres' positions are scaled, not the images.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.registration.errors import LayoutNotFound
from procedures.registration.template import find_layout
from ronna_hw.x_frame import CLOSE_SPHERE_CENTRES_MM
from studies.campaign.study import Sums, Unit, generator
from studies.localization.phantom_scans import PhantomScan, phantom_scan
from studies.localization.study import AUTOMATIC, SAME_SPHERE_MM, SEED_BOUND, Method, localize_by

Array = NDArray[np.float64]
PHANTOM, PATIENT = "phantom", "patient"
FRAME = "xframe-close"
FRAME_MM: Array = np.array(CLOSE_SPHERE_CENTRES_MM)
PROTOCOL = "usual"
PATIENT_FAMILIES = ("narrow", "broad", "clamp", "electrodes", "bandage", "streaks")
# A pixel is too large or too small by one factor in rows and columns, the table feed by another; all values
# up to 1 mm over the width of a head are equally likely. The thesis states nothing about its scanners: this
# is what it takes to come near both of its tables, and more than a scanner in good order has.
LARGEST_SCALE_ERROR = 1.0 / 150.0
SCALE_DRAWS = 100
AXES = "LPS"


@dataclass(frozen=True)
class ThesisScan:
    """A scan of a patient or phantom: its number, phantom family and number of spheres."""

    kind: str
    number: int
    family: str
    spheres: int

    @property
    def condition(self) -> str:
        return f"{self.kind}|{self.number}"


THESIS_SCANS: tuple[ThesisScan, ...] = (
    *(ThesisScan(PHANTOM, number, "plain", 8) for number in range(1, 9)),
    *(
        ThesisScan(PATIENT, number, PATIENT_FAMILIES[(number - 1) // 2], 5 if number % 3 == 0 else 4)
        for number in range(1, 13)
    ),
)


def draw_scale(random: np.random.Generator, count: int, largest: float = LARGEST_SCALE_ERROR) -> Array:
    """Factors (count, 3) by which scans are too large along left, posterior and superior."""
    plane, feed = random.uniform(-largest, largest, (2, count))
    return np.asarray(1.0 + np.column_stack([plane, plane, feed]))


@dataclass(frozen=True, eq=False)
class LocalizedScan:
    """A method's result in a scan: centres (n, 3), LPS mm, and CPU time."""

    centres_mm: Array
    cpu_s: float

    def frame_mm(self, scale: Array) -> Array | None:
        """The frame's spheres (4, 3) in order, in a scan of this scale; None if the frame is refused."""
        seen_mm = self.centres_mm * scale
        try:
            return np.asarray(seen_mm[find_layout(FRAME_MM, seen_mm).order])
        except LayoutNotFound:
            return None


def localize_scan(scan: PhantomScan) -> dict[Method, LocalizedScan]:
    """Localize the scan with our method and with both of the thesis'."""
    found = {}
    for method in AUTOMATIC:
        began_s = time.process_time()
        result = localize_by(method, scan.volume)
        centres_mm = np.empty((0, 3)) if result is None else result.centres_mm
        found[method] = LocalizedScan(centres_mm, time.process_time() - began_s)
    return found


@dataclass(frozen=True)
class ThesisLocalizationStudy:
    """A unit per scan. CPU times differ from run to run; nothing else does."""

    seed: int = 0
    name: str = "localization-thesis"

    def settings(self) -> dict[str, object]:
        return {
            **asdict(self),
            "scans": len(THESIS_SCANS),
            "spheres": sum(scan.spheres for scan in THESIS_SCANS),
            "protocol": PROTOCOL,
            "largest_scale_error": LARGEST_SCALE_ERROR,
            "scale_draws": SCALE_DRAWS,
        }

    def units(self) -> Sequence[Unit]:
        """The scans in order."""
        return [Unit(scan.condition, 0, 1) for scan in THESIS_SCANS]

    def run(self, unit: Unit) -> Sums:
        """Counts, CPU seconds, and the coordinates of the frame's spheres as found by each method, mm."""
        (drawn,) = (scan for scan in THESIS_SCANS if scan.condition == unit.condition)
        random = generator(self.seed, unit)
        seed = int(random.integers(SEED_BOUND))
        sums: dict[str, float] = {}
        with phantom_scan(drawn.family, PROTOCOL, seed, FRAME, drawn.spheres) as scan:
            scales = draw_scale(random, SCALE_DRAWS)
            for method, found in localize_scan(scan).items():
                distance_mm = np.linalg.norm(found.centres_mm[:, None] - scan.centres_mm[None], axis=2)
                near = distance_mm < SAME_SPHERE_MM
                sums[f"{method}|found"] = float(near.any(axis=0).sum())
                sums[f"{method}|false"] = float((~near.any(axis=1)).sum())
                sums[f"{method}|cpu_s"] = found.cpu_s
                sums[f"{method}|validated"] = sum(found.frame_mm(scale) is not None for scale in scales)
                frame_mm = found.frame_mm(np.ones(3))
                if frame_mm is not None:
                    sums.update(points_as_sums(method, frame_mm))
            sums["spheres"] = len(scan.centres_mm)
        return sums


def points_as_sums(who: str, points_mm: Array) -> Sums:
    """Coordinates (4, 3) as entries of the only unit of a condition."""
    return {
        f"{who}|{row} {axis}": float(value)
        for row, point in enumerate(points_mm)
        for axis, value in zip(AXES, point, strict=True)
    }


def points_of(sums: Sums, who: str) -> Array | None:
    """The coordinates (4, 3) back; None if the frame was not found."""
    keys = [[f"{who}|{row} {axis}" for axis in AXES] for row in range(len(FRAME_MM))]
    if keys[0][0] not in sums:
        return None
    return np.array([[sums[key] for key in row] for row in keys])
