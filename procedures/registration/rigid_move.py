"""How a rigid body has moved, from points on it measured before and after in one frame. Pure numerics."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from procedures.registration.error_theory import FreGate
from procedures.registration.point_registration import Registration, register

GATE_CONFIDENCE = 0.999  # of the chi-square gate: one false alarm in a thousand moves


@dataclass(frozen=True)
class RigidMove:
    """The fit after <- before; its errors are those of the two measurements."""

    fit: Registration

    @property
    def way_mm(self) -> float:
        """Displacement of the points' centroid."""
        middle = self.fit.image_mm.mean(axis=0)
        return math.dist(self.fit.transform.apply(middle), middle)

    @property
    def turn_rad(self) -> float:
        """Angle of the rotation."""
        return float(self.fit.transform.rotation.magnitude())

    @property
    def rms_mm(self) -> float:
        """Rms displacement of the points under the move."""
        ways = np.asarray(self.fit.transform.apply(self.fit.image_mm)) - self.fit.image_mm
        return math.sqrt(float(np.square(ways).sum(axis=1).mean()))

    @property
    def gate(self) -> FreGate:
        """Chi-square gate on the covariances: did the points move as one body?"""
        return self.fit.gate(confidence=GATE_CONFIDENCE)

    def error_mm(self, place_mm: ArrayLike) -> float:
        """Predicted rms error of the move at a position (3,) mm before it."""
        return float(self.fit.predict_tre_mm(np.reshape(np.asarray(place_mm, dtype=float), (1, 3)))[0])


def rigid_move(before_mm: ArrayLike, after_mm: ArrayLike, covariance_mm2: ArrayLike) -> RigidMove:
    """The move of paired points (n, 3), n >= 3.

    `covariance_mm2` (n, 3, 3) is the sum over both measurements of each point. Raises REG-001 to REG-006, and
    REG-009 for a mirrored set.
    """
    fit = register(before_mm, after_mm, covariance_mm2=covariance_mm2)
    fit.require_sound()
    return RigidMove(fit)
