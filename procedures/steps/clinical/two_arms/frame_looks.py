"""Looks of the tracker at the frames of both arms, turned in one region: bases within half a millimetre."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.base_to_base import LEAST_FRAME_LOOKS
from procedures.calibration.errors import POSES_OUT_OF_REACH
from procedures.calibration.hand_eye import PosePairs
from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.journal.errors import GateFailed
from procedures.planning.tracker_sight import explain_hidden_frame
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.two_arms.base_postures import (
    FRAME_LOOKS,
    flange_of,
    plan_turns,
    turn_towards,
    working_joints,
)
from procedures.steps.clinical.two_arms.base_visits import ArmVisits, Mover, between_bases, list_possible
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import Workcell
from procedures.workcell.tracker_look import FrameHidden, mean_pose, robot_from_marker, see_both_arms
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.devices.sensors import measuring_volume_mm
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector

Array = NDArray[np.float64]

# Three sigma of the frame's turn on its flange (half a degree) over 0.7 m from home, and of its place (1 mm).
FIRST_GUESS_MM = 20.0
FRAMES = 12  # of the tracker, averaged per look at a frame
# Of the region where both frames are seen, from the middle of the entries, along the axes of the robot:
# between the arms, clear of the one that rests at home.
FROM_ENTRY_MM = (0.0, -200.0, 300.0)


def see_both_home(workcell: Workcell, frames: list[TrackerFrame]) -> tuple[Transform, Transform]:
    """Return the poses of the frames on master and assistant, both home. Raises PRO-007 for a hidden one."""
    try:
        return see_both_arms(workcell, frames)
    except FrameHidden as hidden:
        raise GateFailed(
            f"with both arms home, the tracker does not see the frame {hidden}",
            action="Clear the line of sight between tracker and both arms, then repeat the step.",
        ) from hidden


@dataclass(frozen=True)
class BaseFrameLooks:
    """Looks at the frames of both arms."""

    visits: ArmVisits

    def first_guess(self) -> Transform:
        """Return the base by one look at both frames at home.

        The assistant's is taken as drawn on its flange.
        """
        cell, assistant_arm = self.visits.cell, self.visits.assistant
        master, assistant = see_both_home(cell, self.visits.read(CAREFUL_FRAMES))
        flange = assistant_arm.flange_pose(assistant_arm.joints_rad())
        by_master = robot_from_marker(cell, cell.master.joints_rad()) @ master.inverse()
        base = by_master @ assistant @ (flange @ self.visits.drawn_frame).inverse()
        return between_bases(base.as_matrix())

    def look(self) -> tuple[PosePairs, PosePairs]:
        """Turn the frame of each arm in the region, the other arm at home. Raises CAL-010.

        The assistant stays there: it goes on to hold its ball.
        """
        visits, cell, assistant = self.visits, self.visits.cell, self.visits.assistant
        region_mm = np.mean([one.entry_mm for one in visits.planned_guides()], axis=0) + FROM_ENTRY_MM
        frame = cell.calibrations.tracker_frame
        marker_mm = frame.tool_from_marker.translation_mm
        reference = cell.master.tool_pose(cell.master.home_rad).rigid.rotation
        tracker = visits.context.result(GlobalLocalization).robot_from_tracker.transform
        volume_mm = measuring_volume_mm(cell.tracker)
        found = self._turn(
            (
                partial(cell.master.joints_at, one.pose, cell.master.home_rad, ONE_SIDE)
                for one in plan_turns(reference, region_mm, marker_mm)
            ),
            lambda at: explain_hidden_frame(
                tracker, robot_from_marker(cell, at), cell.master.arm.kinematics, at, volume_mm
            ),
            visits.master_mover(partial(cell.master.settle, arriving=ONE_SIDE, allow_detour=True)),
            frame.tool,
        )
        cell.master.return_home()
        drawn, from_base = visits.drawn_frame, visits.tracker_in_base
        frames_mm = assistant.base.inverse().apply(region_mm)
        home = assistant.flange_pose(assistant.home_rad).rigid.rotation
        facing = (home * drawn.rigid.rotation).as_matrix()[:, 2]
        towards = turn_towards(facing, from_base.translation_mm - frames_mm) * home
        turns = [flange_of(one.pose) for one in plan_turns(towards, frames_mm, drawn.translation_mm)]
        near = working_joints(assistant, turns[:FRAME_LOOKS])
        other = self._turn(
            (partial(assistant.flange_joints, one, near, ONE_SIDE) for one in turns),
            visits.explain_hidden,
            visits.assistant_mover,
            assistant.holder.frame,
        )
        return found, other

    def _turn(
        self,
        plan: Iterable[Callable[[], JointVector]],
        explain_hidden: Callable[[JointVector], str],
        arm: Mover,
        frame: str,
    ) -> PosePairs:
        flanges: list[Array] = []
        seen: list[Array] = []
        reasons: list[str] = []
        for _ in self.visits.visit(list_possible(plan, reasons, explain_hidden), FRAME_LOOKS, arm, reasons):
            pose = mean_pose(self.visits.read(FRAMES, arm), frame, FRAMES // 2)
            if pose is None:
                reasons.append(f"{frame} not in view")
                continue
            flanges.append(arm.flange().as_matrix())
            seen.append(pose.as_matrix())
            doing = f"the {arm.role} turns its frame towards the tracker"
            self.visits.context.progress(len(seen) / FRAME_LOOKS / 4.0, doing)
            if len(seen) == FRAME_LOOKS:
                break
        if len(seen) < LEAST_FRAME_LOOKS:
            raise POSES_OUT_OF_REACH(
                f"too few poses show the frame {frame}",
                expected=f"{LEAST_FRAME_LOOKS}",
                got=f"{len(seen)}; {', '.join(sorted(set(reasons)))}",
            )
        return PosePairs(np.array(flanges), np.array(seen))
