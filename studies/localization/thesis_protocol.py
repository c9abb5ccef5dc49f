"""The thesis' localization protocol: 20 scans, 116 spheres, the frame validated, FLE, gains and times.

Every scan has its own scale error, as with a real scanner; the spheres' positions are scaled, not the images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from studies.campaign.unit import Sums, Unit, generator
from studies.localization.phantom_scans import phantom_scan
from studies.localization.study import SAME_SPHERE_MM, SEED_BOUND
from studies.localization.thesis_scans import (
    FRAME,
    FRAME_MM,
    LARGEST_SCALE_ERROR,
    PROTOCOL,
    THESIS_SCANS,
    draw_scale,
    localize_scan,
)

Array = NDArray[np.float64]

SCALE_DRAWS = 100
AXES = "LPS"


@dataclass(frozen=True)
class ThesisLocalizationStudy:
    """A unit per scan. CPU times differ from run to run; nothing else does."""

    seed: int = 0
    name: str = "localization-thesis"

    def settings(self) -> dict[str, object]:
        """Everything the results depend on."""
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
