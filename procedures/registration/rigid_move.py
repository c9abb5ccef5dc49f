"""How a body has moved, from points on it that were measured before and after in one frame. Pure numerics."""

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
    """The fit after <- before; what it says of an error is that of the two measurements."""

    fit: Registration

    @property
    def way_mm(self) -> float:
        """Way of the points' middle."""
        middle = self.fit.image_mm.mean(axis=0)
        return math.dist(self.fit.transform.apply(middle), middle)

    @property
    def turn_rad(self) -> float:
        """Angle of the rotation."""
        return float(self.fit.transform.rotation.magnitude())

    @property
    def rms_mm(self) -> float:
        """Of the ways that the move gives the points."""
        ways = np.asarray(self.fit.transform.apply(self.fit.image_mm)) - self.fit.image_mm
        return math.sqrt(float(np.square(ways).sum(axis=1).mean()))

    @property
    def gate(self) -> FreGate:
        """Have the points moved as one body, by their covariances?"""
        return self.fit.gate(confidence=GATE_CONFIDENCE)

    def error_mm(self, place_mm: ArrayLike) -> float:
        """Predicted rms error of where the move takes a place (3,) mm of before."""
        return float(self.fit.predict_tre_mm(np.reshape(np.asarray(place_mm, dtype=float), (1, 3)))[0])


def rigid_move(before_mm: ArrayLike, after_mm: ArrayLike, covariance_mm2: ArrayLike) -> RigidMove:
    """The move of paired points (n, 3), n >= 3.

    `covariance_mm2` (n, 3, 3) is that of both measurements of each together. Raises REG-001 to REG-006, and
    REG-009 for a mirrored set.
    """
    fit = register(before_mm, after_mm, covariance_mm2=covariance_mm2)
    fit.require_sound()
    return RigidMove(fit)
