"""Linear model of a look: how motions of the room, errors of the arm and errors of the tracker show in it.

Residuals are seen minus expected, mm and rad in the robot frame, and linear in all unknowns:

    frame on an arm     motion of its base + errors of the arm + place of the frame + place of the base
    sphere              motion of the head + place of the sphere
    frame on the clamp  motion of the clamp + place of that frame

and in all of them the tracker's own error: noise, and a smooth field that changes slowly with the place. Two
looks in one pose share all that is constant; in poses close to each other they share most of it. So the local
error of an uncalibrated arm near a target is known from the looks at the spheres beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from procedures.registration.rigid_fit import pose_jacobian
from procedures.room.sighting import Rest, SeenFrame, SeenSpheres, Sighting, Tracked, marker_pull
from ronna_hw.arm.kinematics import Chain
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.deviations import FLANK_SHARE
from ronna_hw.calibrated_arm.error_budget import BACKLASH_RAD, ErrorSizes, displacements, unit_errors

# Smooth error of the tracker, per axis of its frame, and the way over which it changes: a unit of 0.25 mm
# volumetric accuracy whose error varies over metres. (U)
# Safety against a moved head or cart within the tracker's own error.
FIELD_MM = np.array([0.1, 0.1, 0.2])
FIELD_LENGTH_MM = 300.0

REPEATABILITY_RAD = 2e-5  # per axis, of its orientation (U)
# Places that nothing before the first look tells: of the frame on its mount, a sphere, a base as the tracker
# has it, and each of them after a push or a move that was followed.
UNKNOWN_MM, UNKNOWN_RAD = 20.0, 0.05
JOGGED_RAD = 2e-4  # of a joint, by which an arm is elsewhere: more than encoders jitter
LEVER_MM = 100.0  # between the points whose displacements give a rotation

POSE = 6  # rows of a frame, columns of a motion


class Body(IntEnum):
    """Body that the tracker sees move as one piece, in the order of the columns of a motion."""

    SPHERES = 0
    CLAMP = 1
    BASE = 2  # of the arm with the guide
    ASSISTANT = 3  # base of the second arm


MOTIONS = POSE * len(Body)
HEAD = (Body.SPHERES, Body.CLAMP)
BASES = {Tracked.ARM: Body.BASE, Tracked.ASSISTANT: Body.ASSISTANT}


@dataclass(frozen=True)
class Arrival:
    """Error of an arm for as long as it rests: effects (6, a) of one standard deviation each."""

    rest: Rest
    effects: Array

    def is_of(self, other: Arrival) -> bool:
        """Whether the arm has not moved from one look to the other, nor been jogged."""
        one, then = self.rest, other.rest
        if self is other or one.motions is None or (one.motions, one.sides) != (then.motions, then.sides):
            return self is other
        return bool(np.allclose(one.joints_rad, then.joints_rad, rtol=0.0, atol=JOGGED_RAD))


@dataclass(frozen=True)
class BodyRows:
    """Linearized observation equations of one body: residual (r,) and its noise covariance (r, r).

    `shared` (r, k) are the effects of one standard deviation of each constant, `moved` (r, 24) those of each
    body's motion: a rotation vector (rad) about the room's centre, then a shift (mm), robot frame. `pull`
    (r, 3 m) is the effect of the tracker's smooth error at `markers_mm` (m, 3), along its axes.
    """

    residual: Array
    noise: Array
    shared: Array
    moved: Array
    pull: Array
    markers_mm: Array


@dataclass(frozen=True)
class Rows(BodyRows):
    """Linearized observation equations of one look: residual (r,) and its noise covariance (r, r).

    `shared` (r, k) are the effects of one standard deviation of each constant, `moved` (r, 24) those of each
    body's motion: a rotation vector (rad) about the room's centre, then a shift (mm), robot frame. `pull`
    (r, 3 m) is the effect of the tracker's smooth error at `markers_mm` (m, 3), along its axes. `blocks` are
    the rows of each body that is seen, `arrivals` those of the arms.
    """

    blocks: Mapping[Body, slice]
    arrivals: Mapping[Body, Arrival]
    tracker: int
    head: int


@dataclass(frozen=True)
class Places:
    """Expected spheres (n, 3) mm and frame on the clamp (4, 4), tracker frame."""

    spheres_mm: Array
    clamp: Array | None = None


@dataclass(frozen=True)
class TrackedArm:
    """How an arm errs, and where it carries its frame: FLANGE <- MARKER (4, 4), as recorded.

    `repeatability_mm` is at rest, per axis; `robot_from_base` (4, 4) is where it stands.
    """

    chain: Chain
    sizes: ErrorSizes
    flange_from_marker: Array
    repeatability_mm: float
    robot_from_base: Array = field(default_factory=lambda: np.eye(4))

    @cached_property
    def constants(self) -> int:
        """Number of unknown constants: errors of the arm, pose of its frame, pose of its base."""
        nothing = np.zeros((1, len(self.chain.joints)))
        errors = unit_errors(self.chain, nothing, np.zeros((1, 3)), self.sizes, nothing)
        return int(errors.shape[2]) + 2 * POSE

    @property
    def scatter_mm(self) -> float:
        """Its scatter at rest, per axis."""
        identified = self.sizes.identified
        return max(self.repeatability_mm, 0.0 if identified is None else identified.scatter_mm)

    def errors(self, rest: Rest, place_mm: Array) -> tuple[Array, Array]:
        """Return the unit errors (6, k) of its pose, and those of its arrival (6, a).

        Both are at a place (3,) mm, robot frame.
        """
        turn, shift = self.robot_from_base[:3, :3], self.robot_from_base[:3, 3]
        both = block_diag(turn, turn)
        points = turn.T @ (place_mm - shift) + np.vstack([np.zeros(3), LEVER_MM * np.eye(3)[:2]])
        joints = np.tile(np.array(rest.joints_rad), (len(points), 1))
        sides = np.zeros(len(rest.joints_rad)) if rest.sides is None else np.array(rest.sides, dtype=float)
        moved = displacements(self.chain, joints, points, self.sizes)
        errors = unit_errors(self.chain, joints, points, self.sizes, np.tile(sides, (len(points), 1)), moved)
        scatter = np.diag([self.scatter_mm] * 3 + [REPEATABILITY_RAD] * 3)
        identified = self.sizes.identified
        backlash_rad = BACKLASH_RAD if identified is None else identified.backlash_rad
        half = both @ _as_pose(FLANK_SHARE * backlash_rad * moved.swings_mm)[:, sides == 0.0]
        return both @ _as_pose(errors), np.hstack([scatter, half])


@dataclass(frozen=True)
class RoomModel:
    """Linear model about where the localization found everything.

    `arms` are named by the frames on them. `robot_from_tracker` (4, 4) is as recorded; `centre_mm` (3,) is
    the point about which motions are expressed, robot frame; `spheres` is their number.
    """

    arms: Mapping[Tracked, TrackedArm]
    robot_from_tracker: Array
    centre_mm: Array
    spheres: int

    def rows(self, look: Sighting, flanges: Mapping[Tracked, Array], places: Places) -> Rows:
        """Return the linear model of one look, with the computed poses ROBOT <- FLANGE (4, 4) of the arms."""
        seen = {Body.SPHERES: self._spheres(look.spheres, places.spheres_mm)}
        arrivals: dict[Body, Arrival] = {}
        for name in self.arms:
            if (frame := look.frames.get(name)) is not None:
                body, rest = BASES[name], look.arms[name]
                seen[body], arrival = self._arm(name, rest, frame, flanges[name])
                arrivals[body] = Arrival(rest, arrival)
        if (clamp := look.frames.get(Tracked.CLAMP)) is not None and places.clamp is not None:
            seen[Body.CLAMP] = self._frame(clamp, self.robot_from_tracker @ places.clamp, Body.CLAMP)
        parts, ends = list(seen.values()), np.cumsum([len(one.residual) for one in seen.values()])
        blocks = {
            body: slice(end - len(part.residual), end)
            for (body, part), end in zip(seen.items(), ends.tolist(), strict=True)
            if len(part.residual)
        }
        return Rows(
            np.concatenate([one.residual for one in parts]),
            block_diag(*(one.noise for one in parts)),
            np.vstack([one.shared for one in parts]),
            np.vstack([one.moved for one in parts]),
            block_diag(*(one.pull for one in parts)),
            np.vstack([one.markers_mm for one in parts]),
            blocks,
            arrivals,
            look.tracker,
            look.head,
        )

    def _arm(self, name: Tracked, rest: Rest, seen: SeenFrame, flange: Array) -> tuple[BodyRows, Array]:
        arm, body = self.arms[name], BASES[name]
        marker = flange @ arm.flange_from_marker
        part = self._frame(seen, marker, body)
        errors, arrival = arm.errors(rest, marker[:3, 3])
        on_mount = block_diag(flange[:3, :3] * UNKNOWN_MM, flange[:3, :3] * UNKNOWN_RAD)
        base = part.moved[:, _columns(body)] * _unknown()
        begin = self._begins[name]
        shared = np.zeros_like(part.shared)
        shared[:, begin : begin + arm.constants] = np.hstack([errors, on_mount, base])
        return replace(part, shared=shared), arrival

    def _frame(self, seen: SeenFrame, expected: Array, body: Body) -> BodyRows:
        """Return the rows of a frame expected at a pose (4, 4), robot frame, with its own place unknown."""
        turn, shift = self.robot_from_tracker[:3, :3], self.robot_from_tracker[:3, 3]
        rotated = Rotation.from_matrix(turn @ seen.rotation @ expected[:3, :3].T).as_rotvec()
        residual = np.concatenate([turn @ seen.place_mm + shift - expected[:3, 3], rotated])
        both = block_diag(turn, turn)
        turning = np.hstack([np.eye(3), np.zeros((3, 3))])
        moved = np.zeros((POSE, MOTIONS))
        moved[:, _columns(body)] = np.vstack([pose_jacobian(expected[:3, 3], self.centre_mm), turning])
        pull = both @ np.hstack([*marker_pull(seen.markers_mm - seen.place_mm, seen.shares)])
        own = np.diag([UNKNOWN_MM] * 3 + [UNKNOWN_RAD] * 3)
        shared = np.hstack([np.zeros((POSE, self._constants - POSE)), own])
        return BodyRows(residual, both @ seen.covariance @ both.T, shared, moved, pull, seen.markers_mm)

    def _spheres(self, seen: SeenSpheres, expected_mm: Array) -> BodyRows:
        turn, shift = self.robot_from_tracker[:3, :3], self.robot_from_tracker[:3, 3]
        numbers, count = list(seen.numbers), len(seen.numbers)
        expected = expected_mm[numbers].reshape(-1, 3)
        shared = np.zeros((count, 3, self._constants))
        begin = self._constants - POSE - 3 * self.spheres
        for row, number in enumerate(numbers):
            shared[row, :, begin + 3 * number : begin + 3 * number + 3] = UNKNOWN_MM * np.eye(3)
        moved = np.zeros((count, 3, MOTIONS))
        moved[..., _columns(Body.SPHERES)] = pose_jacobian(expected @ turn.T + shift, self.centre_mm)
        noise = turn @ seen.covariances_mm2 @ turn.T
        return BodyRows(
            ((seen.places_mm - expected) @ turn.T).reshape(-1),
            block_diag(*noise) if count else np.empty((0, 0)),
            shared.reshape(3 * count, self._constants),
            moved.reshape(3 * count, MOTIONS),
            np.asarray(np.kron(np.eye(count), turn), dtype=float),
            seen.places_mm,
        )

    @cached_property
    def _begins(self) -> Mapping[Tracked, int]:
        """First of the constants of each arm; those of the spheres and the frame on the clamp follow."""
        ends = np.cumsum([arm.constants for arm in self.arms.values()]).tolist()
        return dict(zip(self.arms, [0, *ends], strict=False))

    @cached_property
    def _constants(self) -> int:
        """Number of constants: of the arms, the spheres, the frame on the clamp."""
        return sum(arm.constants for arm in self.arms.values()) + 3 * self.spheres + POSE


def covariance_between(one: Rows, others: Sequence[Rows]) -> Array:
    """Return the covariance (r, n) of a look's residual with those of others, or itself, by all constants."""
    by_place = field_covariance(one.markers_mm, np.vstack([other.markers_mm for other in others]))
    pulled = one.pull @ by_place
    parts, begin = [], 0
    for other in others:
        end = begin + other.pull.shape[1]
        part = one.shared @ other.shared.T + pulled[:, begin:end] @ other.pull.T
        if one.tracker and one.tracker == other.tracker:
            part = part + _followed(one, tuple(Body)) @ _followed(other, tuple(Body)).T
        if one.head and one.head == other.head:
            part = part + _followed(one, HEAD) @ _followed(other, HEAD).T
        for body, arrival in one.arrivals.items():
            then = other.arrivals.get(body)
            if then is not None and arrival.is_of(then):
                part[one.blocks[body], other.blocks[body]] += arrival.effects @ then.effects.T
        parts.append(part)
        begin = end
    return np.hstack(parts)


def field_covariance(markers_mm: Array, others_mm: Array) -> Array:
    """Return the covariance (3 m, 3 k) mm2 of the tracker's smooth error between places, tracker frame."""
    apart = ((markers_mm[:, None] - others_mm[None]) ** 2).sum(axis=2)
    return np.kron(np.exp(-apart / (2.0 * FIELD_LENGTH_MM**2)), np.diag(FIELD_MM**2))


def _followed(rows: Rows, bodies: Sequence[Body]) -> Array:
    """Return the effect (r, 6) of a motion of bodies as one, of which nothing is known."""
    return np.asarray(sum(rows.moved[:, _columns(body)] for body in bodies) * _unknown())


def _columns(body: Body) -> slice:
    return slice(POSE * body, POSE * (body + 1))


def _unknown() -> Array:
    return np.array([UNKNOWN_RAD] * 3 + [UNKNOWN_MM] * 3)


def _as_pose(displacements_mm: Array) -> Array:
    """Return pose columns (6, k) from those of a point and of two others `LEVER_MM` from it, (3, 3, k)."""
    origin, x, y = displacements_mm
    by_x, by_y = (x - origin) / LEVER_MM, (y - origin) / LEVER_MM
    return np.vstack([origin, by_y[2], -by_x[2], by_x[1]])
