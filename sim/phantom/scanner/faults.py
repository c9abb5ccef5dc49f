"""Scanner imperfections other than noise: misstated geometry, kernels and beam hardening.

Every fault has a size; the default is none. The truth remains that of the scene: markers where they are.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ronna_hw.near_names import did_you_mean
from sim.errors import BAD_SCENE, SEE_PHANTOM
from sim.phantom.head.painting import PLANE_SIGMA_MM
from sim.phantom.head.shapes import Values
from sim.world.rigid import Point

MOST_TILT_DEG = 30.0  # of a gantry

COARSE_MM = 1.5
ANGLES = 120
DENSE_FROM_HU = 300.0  # above soft tissue and water
# Share of the total path lost per cm of dense matter (water equivalent); a skull then cups by 30 to 60 HU.
LOSS_PER_CM = 0.012
MM_PER_CM = 10.0
HU_PER_WATER = 1000.0


@dataclass(frozen=True)
class Kernel:
    """Reconstruction kernel: in-plane blur, edge enhancement and noise correlation.

    The point spread is (1 + enhanced) times a Gaussian minus `enhanced` times one of twice the width;
    `noise_side` is the tap next to the middle one with which noise is generated, None for that of the blur.
    """

    plane_sigma_mm: float = PLANE_SIGMA_MM
    enhanced: float = 0.0
    noise_side: float | None = None
    name: str = "STANDARD"  # as stated in the series


KERNELS = {
    "standard": Kernel(),
    "smooth": Kernel(0.60, name="SOFT"),
    "sharp": Kernel(0.36, 0.25, -0.25, "BONE"),
}


@dataclass(frozen=True)
class ScannerFaults:
    """Scanner faults of one scan, with patient motion occurring halfway up the markers."""

    tilt_deg: float = 0.0  # of the gantry
    table_scale: float = 0.0  # true over stated table feed, minus 1
    thickness_mm: float | None = None  # of a slice; None: the stated spacing
    beam_hardening: float = 0.0  # 1 is typical
    motion_mm: float = 0.0
    slide_mm: float = 0.0
    kernel: str = "standard"
    extended_range: bool = False  # metal is stored beyond 3071 HU
    tilt_hidden: bool = False  # the headers show upright slices whatever the tilt
    metal_artefacts: bool = False  # streaks and shadows of metal, from the physics of the scan
    stretch: float = 0.0  # of the whole image about its middle, per unit of length
    stretch_along: Point = (0.0, 0.0, 1.0)  # direction of the stretch, LPS

    def __post_init__(self) -> None:
        if self.kernel not in KERNELS:
            raise BAD_SCENE(
                f"unknown kernel {self.kernel!r}",
                expected=", ".join(KERNELS),
                action=f"{did_you_mean(self.kernel, KERNELS)} {SEE_PHANTOM}".lstrip(),
            )
        if abs(self.tilt_deg) > MOST_TILT_DEG:
            raise BAD_SCENE(
                f"no gantry tilts by {self.tilt_deg:g} degrees",
                limit=f"{MOST_TILT_DEG:g} degrees",
                action=SEE_PHANTOM,
            )
        if not 0.0 < float(np.linalg.norm(self.stretch_along)) < np.inf:
            raise BAD_SCENE("a scan is stretched along a direction, three numbers", action=SEE_PHANTOM)
        if self.stretch and self.tilt_deg:
            raise BAD_SCENE("a scan is either tilted or stretched", action=SEE_PHANTOM)
        if self.tilt_hidden and not self.tilt_deg:
            raise BAD_SCENE("a tilt of 0 degrees cannot be hidden", action=SEE_PHANTOM)

    @property
    def stated_tilt_deg(self) -> float:
        """Gantry tilt as stated in the headers."""
        return 0.0 if self.tilt_hidden else self.tilt_deg

    def active(self) -> dict[str, Any]:
        """Return the non-default faults for the truth file."""
        usual = asdict(ScannerFaults())
        return {name: value for name, value in asdict(self).items() if value != usual[name]}


NO_FAULTS = ScannerFaults()


def hardening(image: Values, pixel_mm: float, strength: float) -> Values:
    """Return the beam hardening to add to a slice (rows, columns) in HU, where `strength` 1 is typical.

    Dense bodies absorb the soft part of the beam, so what is in line with them is too dark. A coarse copy of
    the slice is projected in parallel beams. The loss is modelled as proportional to the path through dense
    matter times the total path, the leading term for a scanner with water correction. The error of the
    projections is reconstructed by filtered back-projection.
    """
    import cv2

    step = max(1, round(COARSE_MM / pixel_mm))
    rows, columns = (-(-size // step) for size in image.shape)
    side = int(np.ceil(np.hypot(rows, columns)))
    coarse = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
    water = np.zeros((side, side), dtype=np.float32)
    top, left = (side - rows) // 2, (side - columns) // 2
    water[top : top + rows, left : left + columns] = np.maximum(coarse / HU_PER_WATER + 1.0, 0.0)
    dense = np.where(water > 1.0 + DENSE_FROM_HU / HU_PER_WATER, water - 1.0, np.float32(0.0))
    if not dense.any():
        return np.zeros_like(image)
    cell_cm = step * pixel_mm / MM_PER_CM
    error = np.zeros_like(water)
    loss = np.float32(-strength * LOSS_PER_CM)
    for turn, back in _turns(side):
        whole = cv2.warpAffine(water, turn, (side, side)).sum(axis=0) * cell_cm
        through = cv2.warpAffine(dense, turn, (side, side)).sum(axis=0) * cell_cm
        filtered = _filter_ramp(loss * through * whole, cell_cm)
        smeared = np.broadcast_to(filtered.astype(np.float32), (side, side))
        error += cv2.warpAffine(np.ascontiguousarray(smeared), back, (side, side))
    error *= np.float32(np.pi / ANGLES * HU_PER_WATER)
    shown = error[top : top + rows, left : left + columns]
    return np.asarray(cv2.resize(shown, image.shape[::-1], interpolation=cv2.INTER_LINEAR))


@lru_cache(maxsize=2)
def _turns(side: int) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    import cv2

    middle = ((side - 1) / 2.0, (side - 1) / 2.0)
    angles = [180.0 * number / ANGLES for number in range(ANGLES)]
    return tuple(
        (cv2.getRotationMatrix2D(middle, angle, 1.0), cv2.getRotationMatrix2D(middle, -angle, 1.0))
        for angle in angles
    )


def _filter_ramp(projection: Values, cell_cm: float) -> Values:
    """Apply a ramp filter with cosine roll-off, because a Shepp-Logan filter would ring at a post."""
    count = 2 * len(projection)
    cycles = np.fft.rfftfreq(count, cell_cm)
    roll = np.cos(0.5 * np.pi * cycles / cycles[-1])
    return np.asarray(np.fft.irfft(np.fft.rfft(projection, count) * cycles * roll, count)[: len(projection)])
