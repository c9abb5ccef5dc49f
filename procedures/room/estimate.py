"""One estimate of the room from all looks: how far may a point be from where it is believed to be?

Each look is a measurement whose error is correlated with those of all others (`procedures.room.model`).
Between two looks anything may have moved, and stays so. For each such moment the estimate has the motion of
each body by generalized least squares, with its covariance and its significance: as if every look since had
been compared with every look before, each by what it is worth. What moved is judged at the point that counts,
by the lever that it has there, and nowhere by a limit in millimetres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular
from scipy.special import chdtri

from procedures.registration.rigid_fit import pose_jacobian
from procedures.room.model import HEAD, MOTIONS, POSE, Body, RoomModel, Rows, covariance_between
from ronna_hw.arrays import Array

# Safety against a moved head, cart or tracker (U).
FALSE_ALARM = 1e-4  # share of looks at an undisturbed room that raise an alarm, for each question asked
# Prior of a motion between two looks, per axis; what moves further is plain in any look. (U)
# Safety against a moved head, cart or tracker.
MOTION_RAD, MOTION_MM = 0.02, 5.0

AXES = 3

BODIES = np.eye(MOTIONS).reshape(MOTIONS, len(Body), POSE)
ONE_HEAD = np.asarray(sum(BODIES[:, body] for body in HEAD))  # spheres and clamp as one piece
MOVING: Mapping[str, Array] = {
    "head": ONE_HEAD,
    "base": BODIES[:, Body.BASE],
    "assistant": BODIES[:, Body.ASSISTANT],
    "tracker": -(ONE_HEAD + BODIES[:, Body.BASE] + BODIES[:, Body.ASSISTANT]),
}
# Bodies whose motions displace one thing against another, each with its sign.
GUIDE_AT_HEAD: Mapping[str, float] = {"base": 1.0, "head": -1.0}
INSTRUMENT_IN_GUIDE: Mapping[str, float] = {"assistant": 1.0, "base": -1.0}


@dataclass(frozen=True)
class Displacement:
    """Displacement at a point by a motion before look `since`, robot frame.

    `way_mm` (3,) is the estimate, `covariance_mm2` (3, 3) what the looks leave open of it; `chi_square`, with
    three degrees of freedom, is what the estimate has beyond an undisturbed room.
    """

    since: int
    way_mm: Array
    covariance_mm2: Array
    chi_square: float

    @property
    def noticed_from_mm(self) -> float:
        """Displacement in the direction shown least that is noticed half of the time.

        The external reliability of the looks: Baarda 1968, A testing procedure for use in geodetic networks.
        """
        noncentrality = float(chdtri(AXES, FALSE_ALARM)) - AXES
        return float(np.sqrt(noncentrality * np.linalg.eigvalsh(self.covariance_mm2)[-1]))


@dataclass
class _Further:
    """Answers about one look more, which is asked about several times before it is counted."""

    rows: Rows
    prediction: tuple[Array, Array]
    estimate: RoomEstimate | None = None  # with that look


@dataclass(frozen=True)
class RoomEstimate:
    """Looks so far, whitened, and what each motion before each look would show in them.

    `root` (n, n) is the lower Cholesky root of the covariance of all residuals; `effects` (k, n, 24) are the
    whitened effects of the motions before look k; `information` (k, 24, 24) and `pull` (k, 24) are their
    normal equations.
    """

    model: RoomModel
    looks: tuple[Rows, ...] = ()
    root: Array = field(default_factory=lambda: np.empty((0, 0)))
    residual: Array = field(default_factory=lambda: np.empty(0))
    effects: Array = field(default_factory=lambda: np.empty((0, 0, MOTIONS)))
    information: Array = field(default_factory=lambda: np.empty((0, MOTIONS, MOTIONS)))
    pull: Array = field(default_factory=lambda: np.empty((0, MOTIONS)))
    _asked: list[_Further] = field(default_factory=list, repr=False, compare=False)  # the latest, if any

    def add(self, rows: Rows) -> RoomEstimate:
        """Return the estimate with one look more."""
        further = self._further(rows)
        if further.estimate is None:
            further.estimate = self._extend(rows)
        return further.estimate

    def _extend(self, rows: Rows) -> RoomEstimate:
        before, count = len(self.residual), len(rows.residual)
        beside, covariance = self._predict(rows)
        corner = np.linalg.cholesky(covariance)

        def whiten(values: Array) -> Array:
            return np.asarray(solve_triangular(corner, values, lower=True))

        residual = whiten(rows.residual - beside @ self.residual)
        added = np.repeat(whiten(rows.moved)[None], len(self.looks) + 1, axis=0)
        if self.looks:
            known = self.effects.transpose(1, 0, 2).reshape(before, -1)
            explained = whiten(beside @ known).reshape(count, len(self.looks), MOTIONS)
            added[:-1] -= explained.transpose(1, 0, 2)
        none = np.zeros((1, before, MOTIONS))
        return RoomEstimate(
            self.model,
            (*self.looks, rows),
            np.block([[self.root, np.zeros((before, count))], [beside, corner]]),
            np.concatenate([self.residual, residual]),
            np.concatenate([np.concatenate([self.effects, none]), added], axis=1),
            _longer(self.information) + added.transpose(0, 2, 1) @ added,
            _longer(self.pull) + residual @ added,
        )

    def innovation(self, rows: Rows) -> tuple[Array, Array]:
        """Return what a further look shows beyond expectation (r,), and its covariance (r, r)."""
        beside, covariance = self._predict(rows)
        return rows.residual - beside @ self.residual, covariance

    def displacement_by(self, rows: Rows, point_mm: ArrayLike, bodies: Mapping[str, float]) -> Displacement:
        """Return the displacement at a point (3,) mm, robot frame, if bodies moved before one look more.

        By that look alone, which is not counted.
        """
        values, covariance = self.innovation(rows)
        moving = rows.moved @ np.hstack([MOVING[body] for body in bodies])
        weighted = np.linalg.solve(covariance, moving)
        information, pull = moving.T @ weighted, values @ weighted
        found = self._displace(point_mm, bodies, information[None], pull[None], (MOTION_RAD, MOTION_MM))
        return Displacement(len(self.looks), *(part[0] for part in found))

    def _predict(self, rows: Rows) -> tuple[Array, Array]:
        """Return the regression (r, n) of a further look on the whitened residuals, and its covariance."""
        return self._further(rows).prediction

    def _further(self, rows: Rows) -> _Further:
        if not self._asked or self._asked[0].rows is not rows:
            self._asked[:] = [_Further(rows, self._compute_prediction(rows))]
        return self._asked[0]

    def _compute_prediction(self, rows: Rows) -> tuple[Array, Array]:
        own = rows.noise + covariance_between(rows, [rows])
        if not self.looks:
            return np.empty((len(own), 0)), own
        beside = solve_triangular(self.root, covariance_between(rows, self.looks).T, lower=True).T
        return beside, own - beside @ beside.T

    def displacement(
        self,
        point_mm: ArrayLike,
        since: int,
        bodies: Mapping[str, float] = GUIDE_AT_HEAD,
        size: tuple[float, float] = (MOTION_RAD, MOTION_MM),
    ) -> Displacement:
        """Return the displacement at a point (3,) mm, robot frame, if these bodies moved before a look.

        Each counts with its sign. `size` is the motion that is expected of each before any look, in rad and
        mm per axis.
        """
        since_only = slice(since, since + 1)
        ways, covariances, chi_squares = self._displacements(point_mm, since_only, bodies, size)
        return Displacement(since, ways[0], covariances[0], float(chi_squares[0]))

    def largest(
        self, point_mm: ArrayLike, first: int = 1, bodies: Mapping[str, float] = GUIDE_AT_HEAD
    ) -> Displacement | None:
        """Return the most significant displacement of a point over motions before look `first` or later."""
        if first >= len(self.looks):
            return None
        ways, covariances, chi_squares = self._displacements(point_mm, slice(first, len(self.looks)), bodies)
        at = int(chi_squares.argmax())
        return Displacement(first + at, ways[at], covariances[at], float(chi_squares[at]))

    def _displacements(
        self,
        point_mm: ArrayLike,
        since: slice,
        bodies: Mapping[str, float],
        size: tuple[float, float] = (MOTION_RAD, MOTION_MM),
    ) -> tuple[Array, Array, Array]:
        moving = np.hstack([MOVING[body] for body in bodies])
        information, pull = moving.T @ self.information[since] @ moving, self.pull[since] @ moving
        return self._displace(point_mm, bodies, information, pull, size)

    def _displace(
        self,
        point_mm: ArrayLike,
        bodies: Mapping[str, float],
        information: Array,
        pull: Array,
        size: tuple[float, float],
    ) -> tuple[Array, Array, Array]:
        """Return ways (k, 3), covariances (k, 3, 3) and chi-squares (k,) by normal equations of motions."""
        point = pose_jacobian(np.asarray(point_mm, dtype=float), self.model.centre_mm)
        towards = np.hstack([sign * point for sign in bodies.values()])
        covariance = np.linalg.inv(information + _prior(len(bodies), size))
        gain = towards @ covariance
        ways = np.einsum("kij,kj->ki", gain, pull)
        spread = np.linalg.pinv(gain @ information @ gain.transpose(0, 2, 1), hermitian=True)
        return ways, gain @ towards.T, np.einsum("ki,kij,kj->k", ways, spread, ways)

    def explained(self, body: str | None = None, first: int = 1) -> tuple[Array, Array]:
        """Return how much chi-square a motion before each look from `first` on explains, (k,).

        Also the weights (k, m) of its directions: in an undisturbed room that chi-square is the sum of
        squares of m unit normals, so weighted; what the looks do not show has no weight. The motion is of one
        body, or of all of them, each for itself.
        """
        moving = np.eye(MOTIONS) if body is None else MOVING[body]
        information, prior = moving.T @ self.information[first:] @ moving, _prior(moving.shape[1] // POSE)
        pull = self.pull[first:] @ moving
        motions = np.linalg.solve(information + prior, pull[..., None])[..., 0]
        scale = np.sqrt(np.diag(prior))
        worth = np.maximum(np.linalg.eigvalsh(information / np.outer(scale, scale)), 0.0)
        return (pull * motions).sum(axis=1), worth / (1.0 + worth)


def _longer(values: Array) -> Array:
    return np.concatenate([values, np.zeros((1, *values.shape[1:]))])


def _prior(bodies: int, size: tuple[float, float] = (MOTION_RAD, MOTION_MM)) -> Array:
    """Return the information (6 b, 6 b) that the prior has on the motions of bodies."""
    turn_rad, shift_mm = size
    return np.diag(np.tile([turn_rad**-2] * 3 + [shift_mm**-2] * 3, bodies))
