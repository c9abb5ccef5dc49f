"""Looks of the stereo head at the ball that the assistant holds where it will lead the instrument."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform

from procedures.calibration.base_to_base import LEAST_BALL_LOOKS, BallFit, BallLooks, BaseToBase, refine_bases
from procedures.calibration.errors import POSES_OUT_OF_REACH, DegeneratePoses
from procedures.calibration.pose_set import plan_poses_about
from procedures.steps.clinical.two_arms.base_postures import (
    POSTURES,
    face_along,
    plan_ball_postures,
    turn_towards,
    turns_about_axis,
    working_joints,
    wrist_branches,
)
from procedures.steps.clinical.two_arms.base_visits import ArmVisits, PlannedGuide, list_possible, stated_arms
from procedures.strategies.strategy import ONE_SIDE
from ronna_hw.arrays import Array
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector

BALL_ABOVE_GUIDE_MM = 10.0  # higher, both arms would be in other postures than with the instrument
LEAST_POSTURES = 8  # 16 looks: the instrument is then 0.07 mm off the bore, 2-D, after twelve looks 0.09
LOOKS_PER_POSTURE = 2
LOOKS_TRIED = 6  # for a posture: an arm stands in the way of the other in many
HEAD_TILT_RAD, HEAD_TURN_RAD = math.radians(18.0), math.radians(40.0)
MOST_UNSEEN = 12  # looks in a row that show no ball: it is not where the bases have it
# Safety against bases of two arms that are known too poorly (U).
ENOUGH_MM = 0.08  # stated error at which no more looks are taken


class BallWatch:
    """Looks at the ball of the assistant."""

    def __init__(self, visits: ArmVisits) -> None:
        self._visits = visits
        self.held_rad = visits.assistant.home_rad  # of the assistant in the last look
        self._unseen = 0  # looks in a row

    def look(self, coarse: BaseToBase) -> BallFit:
        """Look at the ball until the bases are known. Raises CAL-003, CAL-004, CAL-010, CAL-022."""
        visits, cell, assistant = self._visits, self._visits.cell, self._visits.assistant
        ball_mm = assistant.holder.flange_from_ball_mm
        base, guides = assistant.base, visits.planned_guides()
        cell.sensors.read_around_tool(visits.context.setting.settings.servo_area_px)
        inwards = -base.inverse().rotation_matrix @ np.mean([one.outwards for one in guides], axis=0)
        reference = face_along(assistant.flange_from_clamp.rotation_matrix[:, 2], inwards)
        middle_mm = np.mean([one.top_mm for one in guides], axis=0)
        middle_mm[2] += BALL_ABOVE_GUIDE_MM
        postures = plan_ball_postures(reference, base, middle_mm, ball_mm)
        near = self._wrist_over(guides, working_joints(assistant, postures))
        looks: list[tuple[Array, Array, Array, JointVector, JointVector]] = []
        reasons: list[str] = []
        held = 0

        def fit() -> BallFit:
            seen = BallLooks(*map(np.array, zip(*looks, strict=True)))
            return refine_bases(coarse, seen, ball_mm, assistant.ball_error_mm, *stated_arms(visits.context))

        plan = (partial(assistant.flange_joints, one, near, ONE_SIDE) for one in postures)
        possible = list_possible(plan, reasons)
        for _ in visits.visit(possible, POSTURES, assistant, assistant.settle, reasons):
            flange, before = assistant.flange_pose(assistant.joints_rad(), ONE_SIDE), len(looks)
            for pose, ball_in_head_mm in self._look_from_around(
                (base @ flange).apply(ball_mm), held, reasons
            ):
                joints_rad = cell.master.joints_rad(), assistant.joints_rad()
                self.held_rad = joints_rad[1]
                looks.append((pose.as_matrix(), ball_in_head_mm, flange.as_matrix(), *joints_rad))
            held += len(looks) > before
            if self._unseen >= MOST_UNSEEN:
                break
            share = 0.5 + min(held / POSTURES, 1.0) / 2.0
            visits.context.progress(share, "looking at the ball")
            if len(looks) < LEAST_BALL_LOOKS or held < LEAST_POSTURES:
                continue
            with suppress(DegeneratePoses):
                if fit().error_mm <= ENOUGH_MM:
                    break
        if len(looks) < LEAST_BALL_LOOKS:
            raise POSES_OUT_OF_REACH(
                "too few looks at the ball of the assistant",
                expected=f"{POSTURES * LOOKS_PER_POSTURE}",
                got=f"{len(looks)}; {', '.join(sorted(set(reasons)))}",
                action="Look whether a cart was moved since the arms were home, and whether the ball is in "
                "its place and in view of the stereo head; then repeat the step.",
            )
        cell.master.return_home()
        assistant.return_home()
        return fit()

    def _wrist_over(self, guides: Sequence[PlannedGuide], usual: JointVector) -> JointVector:
        """Return joints in the branch of the wrist in which the instrument will be inserted.

        That is the usual one unless it hides the assistant's frame from the tracker over a guide, and the
        other does not: in the branch of the looks, the errors of the arm are known.
        """
        assistant = self._visits.assistant
        branch_of = assistant.arm.kinematics.branch_of
        branches = sorted(wrist_branches(assistant), key=lambda one: branch_of(one) != branch_of(usual))
        seen = (near for near in branches if all(self._shows_frame(guide, near) for guide in guides))
        return next(seen, usual)

    def _shows_frame(self, guide: PlannedGuide, near: JointVector) -> bool:
        """Return whether the tracker sees the assistant's frame over a guide, at some turn about its axis."""
        for turn in turns_about_axis(turn_towards((0.0, 0.0, 1.0), -guide.outwards, math.pi)):
            clamp = Transform(Frame.ROBOT, Frame.TOOL, RigidTransform.from_components(guide.start_mm, turn))
            with suppress(LimitError):
                if not self._visits.explain_hidden(self._visits.assistant.clamp_joints(clamp, near)):
                    return True
        return False

    def _look_from_around(
        self, ball_mm: Array, number: int, reasons: list[str]
    ) -> Iterator[tuple[Transform, Array]]:
        """Look at the ball where it is held; yield the pose ROBOT <- TOOL of the head and the ball in TOOL.

        Ways past the assistant are tried first, those via home only if none of them is clear.
        """
        cell, master, looks = self._visits.cell, self._visits.cell.master, 0
        reference = master.tool_pose(master.home_rad).rigid.rotation
        around = plan_poses_about(
            reference,
            ball_mm,
            LOOKS_TRIED,
            number * LOOKS_TRIED,
            tilt_rad=HEAD_TILT_RAD,
            turn_rad=HEAD_TURN_RAD,
        )
        for allow_detour in (False, True):
            plan = (partial(master.joints_at, one.pose, master.home_rad, ONE_SIDE) for one in around)
            settle = partial(master.settle, arriving=ONE_SIDE, allow_detour=allow_detour)
            possible = list_possible(plan, reasons)
            for _ in self._visits.visit(possible, LOOKS_PER_POSTURE, master, settle, reasons):
                seen = cell.look()
                if seen.point is None:
                    self._unseen += 1
                    reasons.append(seen.reason)
                    continue
                self._unseen = 0
                yield master.tool_pose(arrived=ONE_SIDE), np.asarray(seen.point.position_mm)
                looks += 1
                if looks == LOOKS_PER_POSTURE:
                    return
            if looks or master.place.is_home:
                return
