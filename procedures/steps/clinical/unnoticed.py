"""Changes of the room that no look would show, as shares of the error at a target.

Before a registration is accepted, the looks that are still to come are known: with the arm home, and at the
target. They are added to the estimate as they are expected; what a motion may then still be is what nobody
would notice. At the target, the looks that were had take their place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from procedures.calibration.guide_load import LoadEstimate
from procedures.engine.context import StepContext
from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.guards.room_watch import RoomLook, RoomWatch
from procedures.guards.stability import Subject, guide_unnoticed_mm
from procedures.planning.tracker_sight import explain_hidden_frame
from procedures.registration.movement import LEAST_POINTS
from procedures.room.estimate import RoomEstimate
from procedures.room.sighting import Rest, SeenSpheres, Sighting, Tracked, expect_frame, expect_spheres
from procedures.steps.clinical.guide_load import require_unloaded
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import RegisteredRobot
from procedures.steps.clinical.room import check_room, room_watch
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell.tracker_look import robot_from_marker
from ronna_hw.arrays import Array
from ronna_hw.devices.sensors import measuring_volume_mm
from ronna_hw.vectors import JointVector

# Safety against a move that no look shows (U).
MOST_LOOKS = 4  # of a second each; more of them show little more
# A hand that leans on the guide, per axis, where the signals of the load do not bound it closer. (U)
# Safety against a hand on the guide that no look shows.
HELD_MM, HELD_RAD = 0.3, 1e-3

POORER = 1.25  # than expected, from which on the operator is told
UNNOTICED = "unnoticed change: {}"
HEAD, BASE, GUIDE = (UNNOTICED.format(one) for one in (Subject.HEAD, Subject.BASE, Subject.GUIDE))


def expect_unnoticed(
    context: StepContext, tip_mm: Array, joints_rad: JointVector, sides: Sequence[int] | None
) -> dict[str, Array]:
    """Return covariances (3, 3) mm2 of what the looks to come will not show at a target, by source.

    The target (3,) mm and the covariances are in the robot frame.
    `joints_rad` hold the guide there, having arrived from `sides` of their backlash.
    """
    workcell, watch = context.workcell, room_watch(context)
    spheres = expect_spheres(watch.spheres_mm, CAREFUL_FRAMES)
    estimate = watch.with_look(_expect_look(context, watch, workcell.master.home_rad, ONE_SIDE, spheres))
    at_home = len(estimate.looks) - 1
    head = estimate.displacement(tip_mm, at_home, {"head": -1.0})
    here = watch.robot_from_tracker @ watch.tracker.move.inverse()
    marker = robot_from_marker(workcell, joints_rad, sides)
    volume_mm = measuring_volume_mm(workcell.tracker)
    if not explain_hidden_frame(here, marker, workcell.master.arm.kinematics, joints_rad, volume_mm):
        at_target = _expect_look(context, watch, joints_rad, sides, SeenSpheres())
        estimate = watch.with_look(at_target, estimate)
    base_mm2 = _base_unnoticed_mm2(estimate, tip_mm, at_home, at_home + 1)
    guide_mm = guide_unnoticed_mm(workcell.master.arm.kinematics.name)
    return {HEAD: head.covariance_mm2, BASE: base_mm2, GUIDE: np.eye(3) * guide_mm**2 / 3.0}


def _base_unnoticed_mm2(
    estimate: RoomEstimate, tip_mm: Array, at_home: int, at_target: int, held_mm: float = HELD_MM
) -> Array:
    """Return the covariance (3, 3) mm2 of what looks at home and at the target do not show of the arm.

    A cart that has moved stays so, and both see it; a hand on the guide is seen at the target alone, but does
    not displace it far. The larger of the two counts.
    """
    moved = estimate.displacement(tip_mm, at_home, {"base": 1.0}).covariance_mm2
    held = held_mm**2 * np.eye(3)
    if at_target < len(estimate.looks):
        held = estimate.displacement(tip_mm, at_target, {"base": 1.0}, (HELD_RAD, held_mm)).covariance_mm2
    return max(moved, held, key=lambda part: float(np.trace(part)))


def look_at_target(context: StepContext) -> RoomLook:
    """Look at the room with the guide held, as often as the plan's margin needs; raises as `check_room`.

    The load on the arm by its controller bounds by how much a hand displaces the guide, or raises PRO-052.
    Records by how much what these looks leave open adds to the predicted error, if it is more than expected.
    """
    trajectory, occasion = context.trajectory, f"at {context.trajectory}"
    checked, predicted = context.result(CheckedPlan), context.result(RegisteredRobot).prediction(trajectory)
    margin_mm = checked.trajectory(trajectory).margin_mm
    counted_mm = next((one.rms_mm for one in predicted.budget if one.source == BASE), None)
    before = len(room_watch(context).estimate.looks)
    for number in range(MOST_LOOKS):
        look, load = check_room(context, occasion, CAREFUL_FRAMES), require_unloaded(context)
        if counted_mm is None:  # in records of earlier versions
            return look
        unnoticed_mm = _base_unnoticed_mm(room_watch(context), trajectory, before, load)
        total_mm = math.sqrt(predicted.rms_mm**2 + unnoticed_mm**2 - counted_mm**2)
        if total_mm <= margin_mm or look.base_mm is None:
            break
        context.progress(
            0.9 + 0.1 * number / MOST_LOOKS,
            f"looking again {occasion}: what may have moved makes {total_mm:.2f} mm, margin {margin_mm:g} mm",
        )
    if counted_mm is not None and (unnoticed_mm > POORER * counted_mm or total_mm > margin_mm):
        context.find(
            f"{occasion} the tracker sees less of the arm than was expected: the predicted error grows from "
            f"{predicted.rms_mm:.2f} to {total_mm:.2f} mm rms (margin {margin_mm:g} mm), by what may "
            "have moved unnoticed",
            [trajectory],
        )
    return look


def _base_unnoticed_mm(watch: RoomWatch, trajectory: str, at_target: int, load: LoadEstimate | None) -> float:
    """Return the rms of what the looks at the target, from number `at_target` on, do not show of the arm."""
    held_mm = HELD_MM
    if load is not None:
        held_mm = min(HELD_MM, math.sqrt(float(np.trace(load.displacement_covariance_mm2)) / 3.0))
    point_mm = watch.points_mm[trajectory]
    part = _base_unnoticed_mm2(watch.estimate, point_mm, watch.settled_home, at_target, held_mm)
    return math.sqrt(float(np.trace(part)))


def _expect_look(
    context: StepContext,
    watch: RoomWatch,
    joints_rad: JointVector,
    sides: Sequence[int] | None,
    spheres: SeenSpheres,
) -> Sighting:
    """Return a careful look as the arm at these joints would give it, with the frame on it in view.

    A head with fewer than three spheres is seen by the frame on its clamp.
    """
    workcell = context.workcell
    by_frame = watch.expect_clamp() if len(watch.spheres_mm) < LEAST_POINTS else {}
    on_arm = (watch.robot_from_tracker.inverse() @ robot_from_marker(workcell, joints_rad, sides)).as_matrix()
    markers_mm = workcell.tracker.markers_mm[workcell.calibrations.tracker_frame.tool]
    frame = expect_frame(on_arm[:3, 3], on_arm[:3, :3], markers_mm, CAREFUL_FRAMES)
    rests = None if sides is None else tuple(sides)
    return Sighting(
        {Tracked.ARM: Rest(joints_rad, rests)},
        spheres,
        {Tracked.ARM: frame, **by_frame},
        watch.tracker.pushes,
        watch.epoch,
    )
