"""The thesis' scans: 12 of patients and 8 of a phantom, 116 spheres, the x-shaped frame in each.

Phantoms stand in for both. The number of spheres implies that some scans contain more than the frame's four;
their distribution is our choice. The frame is the close one.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.imaging import Localization, ThesisFit, localize, localize_as_thesis
from procedures.imaging.errors import MarkerCountWrong
from procedures.registration.errors import LayoutNotFound
from procedures.registration.template import find_layout
from ronna_hw.x_frame import CLOSE_SPHERE_CENTRES_MM
from studies.localization.phantom_scans import PhantomScan
from studies.localization.study import AUTOMATIC, Method

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


@dataclass(frozen=True)
class ThesisScan:
    """One scan: patient or phantom, its number among these, random parameters, and number of spheres."""

    kind: str
    number: int
    family: str
    spheres: int

    @property
    def condition(self) -> str:
        """Readable key."""
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
    """What one method found in a scan: all centres (n, 3), LPS mm, and its CPU time."""

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
        centres_mm = np.empty((0, 3))
        with contextlib.suppress(MarkerCountWrong):
            centres_mm = _localization(method, scan).centres_mm
        found[method] = LocalizedScan(centres_mm, time.process_time() - began_s)
    return found


def _localization(method: Method, scan: PhantomScan) -> Localization:
    if method is Method.OURS:
        return localize(scan.volume)
    return localize_as_thesis(scan.volume, ThesisFit(method.value))
