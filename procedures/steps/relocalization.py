"""Fine localization of every matched sphere by visual servo, oriented as the strategy says.

The tool centre is moved onto a sphere until the residual is below the tolerance. Recorded is the nominal
tool pose plus the last residual. What the first sphere teaches about the offset of the coarse positions
helps to find the next one.

Every position that is looked from is approached with each joint turning the way it will turn on its way to
the target, so that backlash is the same in all of them and cancels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from procedures.engine.errors import GateFailed, SphereNotFound
from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.relocalization import ServoState, recorded_point, search_pose
from procedures.relocalization.errors import SphereNotInView
from procedures.steps.arm_frames import stereo_tool_in_flange, tool_pose
from procedures.steps.payloads import points_payload, pose_from
from procedures.steps.stereo_look import Look, area_around_tool, look, whole_sensor
from procedures.steps.stereo_picture import keep_picture
from procedures.steps.surroundings import move_clear, surround_stereo_head
from procedures.strategies.orientation import back_along_axis
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import JointVector
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

# How far each joint stands back before it turns onto a position: ten times the backlash of a worn gear.
APPROACH_RAD = math.radians(0.2)


@dataclass(frozen=True)
class FoundSphere:
    """One sphere, measured: `point_mm` in the robot frame, `residual_mm` the servo's way to it."""

    fiducial: int
    point_mm: Array
    residuals_mm: tuple[float, ...]
    covariance_mm2: Array  # of the stereo measurement, robot frame
    ray_gap_mm: float
    looks: int
    joints_rad: JointVector


def run(context: StepContext) -> Outcome:
    """Re-localize all matched spheres for one trajectory; raises PRO-008 for a sphere that is not there."""
    path_check = context.case.get("path_check")
    planned = path_check.payload["localizations"][str(context.key.trajectory)]
    surround_stereo_head(context)
    _activate(context)
    offset_mm = np.zeros(3)
    found: list[FoundSphere] = []
    for number, item in enumerate(planned):
        context.progress(number / len(planned), f"centring sphere {item['fiducial'] + 1}")
        expected = _shifted(pose_from(item["tool_pose"]), offset_mm)
        near: JointVector = tuple(item["approach_rad"])
        sphere = centre_on(context, int(item["fiducial"]), expected, near)
        offset_mm = sphere.point_mm - pose_from(item["tool_pose"]).translation_mm
        found.append(sphere)
    coarse = np.array([item["tool_pose"]["translation_mm"] for item in planned])
    differences = np.array([sphere.point_mm for sphere in found]) - coarse
    _gate(context, differences)
    return Outcome(
        payload={
            "fiducials": [sphere.fiducial for sphere in found],
            "points_robot_mm": points_payload([sphere.point_mm for sphere in found]),
            "covariances_mm2": [sphere.covariance_mm2.tolist() for sphere in found],
            "residuals_mm": [list(sphere.residuals_mm) for sphere in found],
            "ray_gaps_mm": [sphere.ray_gap_mm for sphere in found],
            "looks": [sphere.looks for sphere in found],
            "joints_rad": [list(sphere.joints_rad) for sphere in found],
            "coarse_offset_mm": differences.mean(axis=0).tolist(),
        },
        parents=(path_check, context.case.get("set_up"), context.case.get("fiducial_localization")),
        summary=f"{len(found)} spheres, last residuals at most "
        f"{max(sphere.residuals_mm[-1] for sphere in found):.3f} mm",
    )


def _activate(context: StepContext) -> None:
    for device in (context.devices.arm, context.devices.stereo):
        if device.state is Lifecycle.CONFIGURED:
            device.activate()


def centre_on(context: StepContext, fiducial: int, expected: Transform, near: JointVector) -> FoundSphere:
    """Approach one sphere along the tool axis, servo onto it, and back off the same way."""
    _move_joints(context, _standoff(context, expected), near)
    _move_linear(context, expected)
    _settle_onto(context, expected)
    seen, looks = _first_look(context, expected)
    servo = ServoState()
    while True:
        joints = context.devices.arm.read_state().joints_rad
        pose = tool_pose(context, joints, stereo_tool_in_flange(context))
        if seen.point is None:
            raise SphereNotFound(f"sphere {fiducial + 1} was lost during the servo", got=seen.reason)
        servo = servo.measured(pose, seen.point.position_mm)
        if servo.converged:
            break
        _settle_onto(context, servo.next_pose(pose))
        seen, looks = look(context), looks + 1
        if seen.point is None:  # noise may cost one look; a sphere that is hidden or gone stays so
            _look_at_all(context)
            seen, looks = look(context), looks + 1
    keep_picture(context, fiducial, seen)
    _move_linear(context, _standoff(context, pose))
    rotation = pose.rotation_matrix
    return FoundSphere(
        fiducial=fiducial,
        point_mm=recorded_point(pose, seen.point.position_mm),
        residuals_mm=servo.residuals_mm,
        covariance_mm2=rotation @ seen.point.covariance_mm2 @ rotation.T,
        ray_gap_mm=float(seen.point.ray_gap_mm),
        looks=looks,
        joints_rad=joints,
    )


def _first_look(context: StepContext, expected: Transform) -> tuple[Look, int]:
    """Look in the servo's area, then on the whole sensors, then around in a spiral."""
    calibration, stereo = context.calibrations.stereo_head, context.devices.stereo
    size = context.theatre.procedure.servo_area_px
    areas = (area_around_tool(calibration.left, size), area_around_tool(calibration.right, size))
    stereo.set_areas(*areas)
    seen, looks = look(context), 1
    if seen.point is not None:
        return seen, looks
    _look_at_all(context)
    seen, looks = look(context), looks + 1
    telling = seen  # the look with the best reason for a refusal: nearest to the place, or with a sphere
    try:
        while seen.point is None:
            _settle_onto(context, search_pose(expected, looks - 2))
            seen, looks = look(context), looks + 1
            if telling.left is None and seen.left is not None:
                telling = seen
    except SphereNotInView as error:
        raise SphereNotFound(f"{error.what}: {telling.reason}", limit=error.limit) from error
    return seen, looks


def _look_at_all(context: StepContext) -> None:
    head = context.calibrations.stereo_head
    context.devices.stereo.set_areas(whole_sensor(head.left), whole_sensor(head.right))


def _move_joints(context: StepContext, pose: Transform, near: JointVector) -> None:
    move_clear(context, _joints(context, pose, near))


def _settle_onto(context: StepContext, pose: Transform) -> None:
    """Take a pose with every joint arriving from the side from which it arrives at the target."""
    arm = context.devices.arm
    target = context.case.get("path_check").payload["targets"][str(context.key.trajectory)]
    joints = _joints(context, pose, arm.read_state().joints_rad)
    back: Any = tuple(
        joint - sign * APPROACH_RAD for joint, sign in zip(joints, target["approach_signs"], strict=True)
    )
    arm.move_joints(back)
    arm.move_joints(joints)


def _joints(context: StepContext, pose: Transform, near: JointVector) -> JointVector:
    kinematics = context.devices.arm.kinematics
    flange = Pose.from_transform(pose @ stereo_tool_in_flange(context).inverse())
    return kinematics.solve_branch(flange, kinematics.branch_of(near), near)


def _move_linear(context: StepContext, pose: Transform) -> None:
    context.devices.arm.move_linear(pose @ stereo_tool_in_flange(context).inverse())


def _standoff(context: StepContext, pose: Transform) -> Transform:
    return back_along_axis(pose, context.theatre.procedure.standoff_mm)


def _shifted(pose: Transform, offset_mm: Array) -> Transform:
    return Transform.of(
        Frame.ROBOT,
        Frame.TOOL,
        translation_mm=pose.translation_mm + offset_mm,
        quaternion_wxyz=pose.quaternion_wxyz,
    )


def _gate(context: StepContext, differences_mm: Array) -> None:
    """A sphere whose fine position disagrees with the coarse one is another one, or the patient moved.

    What all spheres share is the tool frame's error and is removed first.
    """
    limit = context.theatre.procedure.coarse_fine_limit_mm
    apart: Any = np.linalg.norm(differences_mm - differences_mm.mean(axis=0), axis=1)
    if apart.max() > limit:
        raise GateFailed(
            f"sphere {int(apart.argmax()) + 1} is not where the tracker saw it",
            limit=f"{limit:g} mm",
            got=f"{apart.max():.2f} mm",
            action="Check that the patient has not moved, then localize with the tracker again.",
        )


STEP = StepSpec(
    "relocalization",
    "Re-localize the spheres with the stereo head",
    needs=("path_check", "correspondence"),
    run=run,
    per_trajectory=True,
    moves=True,
)
