"""What the looks show of a moved body and what the target feels of it, linear, from truth and geometry alone.

A move is a twist in the robot frame: the displacement (mm) of a point, then the rotation about it as the
displacement at `ARM_MM` from it, so that all six numbers are millimetres. The looks at home are the means of
the tracker's frames of each sphere and of the markers of each frame, and the guide's gauge. A hand at the
guide is gone by then: single frames of the markers on it, over the target, are all that shows it. The
procedure's own estimate of the room has no part in this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, eigh

from procedures.strategies.trajectory import Trajectory, target_pose
from ronna_hw import patient_frame
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame
from sim.polaris.measurement.optics import Optics
from sim.polaris.unit.model import SPECTRA
from sim.world.displacements import spheres_in_theatre
from sim.world.options import ArmRole
from sim.world.rigid import Matrix, apply, inverse, matrix_from, matrix_of, rotation_from_vector
from sim.world.scene.model import ArmTruth, Scene
from sim.world.scene.parts import (
    ASSISTANT_FRAME_MARKERS_MM,
    GUIDE_FRAME_IN_TIP,
    GUIDE_FRAME_MARKERS_MM,
)
from sim.world.scene.plan_feasibility import STANDOFF_MM
from sim.world.true_arm import TrueArm, arm_seed

FRAMES = 60  # of the tracker, in the mean of one look
HELD_FRAMES = 1  # while a hand holds the guide
POINT_MM = 0.03  # what such a mean errs per axis from look to look, besides its noise
FRAME_MM = 0.03  # the same of a whole frame
APPROACHES = 3  # readings of the gauge in its mean
ARM_MM = 100.0
FLANKS = (1.0,) * 6  # each joint rests on this side of its backlash
TWIST = 6


class MovedBody(StrEnum):
    """A body that can be moved, named as in a fault script."""

    HEAD = "head"
    CART = "cart"
    ASSISTANT_CART = "assistant_cart"
    TRACKER = "tracker"
    SEAT = "seat"  # the guide in it
    GUIDE = "guide"  # by a hand


CARTS = {ArmRole.MASTER: MovedBody.CART, ArmRole.ASSISTANT: MovedBody.ASSISTANT_CART}


@dataclass(frozen=True)
class HiddenMove:
    """A twist of one or more bodies: what the looks resolve of it, and what the target feels.

    `twist_mm` has six numbers for each body. `sigmas` is its size in standard deviations of the looks,
    `effect_mm` the displacement of the guide against the target, or of an instrument against its bore.
    """

    bodies: tuple[MovedBody, ...]
    twist_mm: Array
    sigmas: float
    effect_mm: float


class Looks:
    """The looks of a scene, and one of its targets."""

    def __init__(self, scene: Scene, target: int) -> None:
        self.scene = scene
        head, mount, tracker = scene.head, scene.mount, scene.tracker
        self._robot_from_tracker = matrix_of(tracker.robot_from_tracker)
        self._optics = Optics(tracker, scene.seed, SPECTRA.volumes)
        robot_from_ct = matrix_of(head.robot_from_ct)
        on_head_mm = [apply(robot_from_ct, [one.centre_ct_mm for one in spheres_in_theatre(scene)])]
        if head.robot_from_patient_frame is not None:
            on_head_mm.append(apply(matrix_of(head.robot_from_patient_frame), patient_frame.MARKERS_MM))
        self._on_head_mm = np.vstack(on_head_mm)
        self._markers_mm = np.array(tracker.tools[0].markers_mm)
        self.flange_from_marker = matrix_of(mount.flange_from_tool_true) @ matrix_of(
            mount.tool_from_marker_true
        )
        self.home_frame_mm = apply(_home(scene.arm, scene.seed) @ self.flange_from_marker, self._markers_mm)
        planned = head.targets[target]
        self.target_mm: Array = apply(robot_from_ct, planned.target_ct_mm)
        trajectory = Trajectory(
            planned.identifier,
            planned.entry_ct_mm,
            planned.target_ct_mm,
            math.radians(planned.free_angle_deg),
        )
        trajectory = trajectory.with_rest(mount.guide.reach_mm - STANDOFF_MM - trajectory.depth_mm)
        # The tip frame over the target: the end of the mandrel with which the guide was calibrated.
        self.tip = target_pose(trajectory, head.robot_from_ct.transform(Frame.ROBOT, Frame.CT)).as_matrix()
        flange_from_tip = matrix_of(mount.flange_from_tool_true) @ matrix_of(mount.tool_from_tip_true)
        self.mount_frame = self.tip @ inverse(flange_from_tip) @ self.flange_from_marker
        self._guide_markers_mm = apply(self.tip @ matrix_of(GUIDE_FRAME_IN_TIP), GUIDE_FRAME_MARKERS_MM)

    @property
    def _sighted(self) -> tuple[MovedBody, ...]:
        """The bodies that the tracker sees at home."""
        return (MovedBody.HEAD, *(CARTS[role] for role in self.scene.arms))

    def centre_mm(self, body: MovedBody) -> Array:
        """Return the point (3,) about which a fault script turns a body, robot frame."""
        scene = self.scene
        match body:
            case MovedBody.HEAD:
                return apply(matrix_of(scene.head.robot_from_ct), scene.head.centre_ct_mm)
            case MovedBody.CART:
                return np.zeros(3)
            case MovedBody.ASSISTANT_CART:
                assert scene.assistant is not None
                return matrix_of(scene.assistant.robot_from_base)[:3, 3]
            case MovedBody.TRACKER:
                return self._robot_from_tracker[:3, 3]
            case MovedBody.SEAT:
                return self.tip[:3, 3]
            case MovedBody.GUIDE:
                return self.mount_frame[:3, 3]

    def information(self, body: MovedBody) -> Array:
        """Return the information (6, 6) of the looks about a body's twist, per mm2."""
        seen = self._jacobian(self._points_mm(body), body)
        found: Array = seen.T @ np.linalg.solve(self._covariance_mm2(body), seen)
        return found + self._gauge_information() if body is MovedBody.SEAT else found

    def shared_information(self, body: MovedBody) -> Array:
        """Return the information (6, 6) that remains where the tracker may have moved as well.

        A move of the tracker alone displaces everything that it sees alike; what looks like one is not told
        from a move of all bodies.
        """
        # The twist of every body is taken about the same point, so that the tracker's is minus each of them.
        about_mm = self.centre_mm(body)
        each = {one: self._information_about(one, about_mm) for one in self._sighted}
        whole: Array = np.sum(list(each.values()), axis=0)
        own = each[body]
        return own - own @ np.linalg.solve(whole, own)

    def feeling(self, body: MovedBody) -> Array:
        """Return the displacement (3, 6) of the guide against the target per mm of a body's twist.

        The cart of an assistant moves the instrument against the bore instead, on average of its two ends.
        """
        match body:
            case MovedBody.TRACKER:
                return np.zeros((3, TWIST))
            case MovedBody.ASSISTANT_CART:
                bore, axis = self.scene.mount.guide, self.tip[:3, 2]
                middle_mm = self.tip[:3, 3] - (bore.reach_mm + bore.bore_mm / 2.0) * axis
                across = np.eye(3) - np.outer(axis, axis)
                return np.asarray(across @ self._jacobian(middle_mm[None], body))
            case MovedBody.HEAD:
                return -self._jacobian(self.target_mm[None], body)
            case _:
                return self._jacobian(self.target_mm[None], body)

    def displacement(self, body: MovedBody, twist_mm: Array) -> Matrix:
        """Return a body's twist as a displacement (4, 4) in the robot frame."""
        about_mm = self.centre_mm(body)
        turn = rotation_from_vector(twist_mm[3:] / ARM_MM)
        return matrix_from(about_mm - turn @ about_mm + twist_mm[:3], turn)

    def _information_about(self, body: MovedBody, about_mm: Array) -> Array:
        seen = _jacobian(self._points_mm(body), about_mm)
        found: Array = seen.T @ np.linalg.solve(self._covariance_mm2(body), seen)
        return found

    def _jacobian(self, points_mm: Array, body: MovedBody) -> Array:
        return _jacobian(points_mm, self.centre_mm(body))

    def _points_mm(self, body: MovedBody) -> Array:
        """Return the points (n, 3) that the tracker sees move with a body, or for the tracker all of them."""
        match body:
            case MovedBody.HEAD:
                return self._on_head_mm
            case MovedBody.CART:
                return self.home_frame_mm
            case MovedBody.ASSISTANT_CART:
                return self._assistant_frame_mm
            case MovedBody.TRACKER:
                return np.vstack([self._points_mm(one) for one in self._sighted])
            case MovedBody.SEAT:
                return self._guide_markers_mm
            case MovedBody.GUIDE:
                return np.vstack([apply(self.mount_frame, self._markers_mm), self._guide_markers_mm])

    def _covariance_mm2(self, body: MovedBody) -> Array:
        """Return the covariance (3 n, 3 n) of these points in one look."""
        if body is MovedBody.TRACKER:
            joined: Array = block_diag(*(self._covariance_mm2(one) for one in self._sighted))
            return joined
        points_mm = self._points_mm(body)
        seen_mm = apply(inverse(self._robot_from_tracker), points_mm)
        frames = HELD_FRAMES if body is MovedBody.GUIDE else FRAMES
        variances = self._optics.sight(seen_mm).sigma_mm ** 2 / frames + POINT_MM**2
        turn = self._robot_from_tracker[:3, :3]
        single: Array = block_diag(*(turn @ np.diag(one) @ turn.T for one in variances))
        repeats_mm = self._repeatability_mm(body)
        if repeats_mm is None:
            return single
        common = np.tile(np.eye(3), (len(points_mm), len(points_mm)))
        return single + (FRAME_MM**2 + repeats_mm**2) * common

    def _repeatability_mm(self, body: MovedBody) -> float | None:
        """Return the repeatability of the arm on which these points are, or None for the head."""
        match body:
            case MovedBody.HEAD:
                return None
            case MovedBody.ASSISTANT_CART:
                assert self.scene.assistant is not None
                return self.scene.assistant.arm.repeatability_mm
            case _:
                return self.scene.arm.repeatability_mm

    def _gauge_information(self) -> Array:
        """Return what the dials of the gauge show of the seat: the mandrel's end, and two axes higher up."""
        guide = self.scene.mount.guide
        higher_mm = self.tip[:3, 3] - guide.bore_mm * self.tip[:3, 2]
        turn = self.tip[:3, :3].T
        rows = np.vstack(
            [
                turn @ self._jacobian(self.tip[:3, 3][None], MovedBody.SEAT),
                (turn @ self._jacobian(higher_mm[None], MovedBody.SEAT))[:2],
            ]
        )
        variance = (self.scene.hands.gauge_mm**2 + self.scene.arm.repeatability_mm**2) / APPROACHES
        found: Array = rows.T @ rows / variance
        return found

    @cached_property
    def _assistant_frame_mm(self) -> Array:
        assistant = self.scene.assistant
        assert assistant is not None
        home = _home(assistant.arm, arm_seed(self.scene.seed, ArmRole.ASSISTANT))
        frame = matrix_of(assistant.robot_from_base) @ home @ matrix_of(assistant.flange_from_frame)
        return apply(frame, ASSISTANT_FRAME_MARKERS_MM)


def find_hidden_moves(looks: Looks, bodies: tuple[MovedBody, ...]) -> list[HiddenMove]:
    """Return the moves of one standard deviation that the target feels most, the worst first.

    With the tracker among the bodies, only the other one's move counts: that of the tracker is known to be
    harmless, and may cover it.
    """
    felt_by = tuple(one for one in bodies if one is not MovedBody.TRACKER)
    information = [
        looks.shared_information(one) if MovedBody.TRACKER in bodies else looks.information(one)
        for one in felt_by
    ]
    feeling = np.hstack([looks.feeling(one) for one in felt_by])
    gains, twists = eigh(feeling.T @ feeling, block_diag(*information))
    moves = [
        HiddenMove(felt_by, twists[:, number], 1.0, math.sqrt(max(0.0, gains[number])))
        for number in range(len(gains))
    ]
    return sorted(moves, key=lambda one: -one.effect_mm)


def _jacobian(points_mm: Array, about_mm: Array) -> Array:
    """Return the displacement (3 n, 6) of points (n, 3) per mm of a twist about a point."""
    rows = []
    for x, y, z in points_mm - about_mm:
        cross = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]) / ARM_MM
        rows.append(np.hstack([np.eye(3), cross]))
    return np.vstack(rows)


def _home(arm: ArmTruth, seed: int) -> Matrix:
    return TrueArm(arm, seed).moving([math.radians(angle) for angle in arm.home_deg], FLANKS)
