"""Centring of the tool on a sphere: straight there or along the tool axis, look and servo."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from procedures.relocalization import ServoSettings, ServoState, recorded_point, search_pose
from procedures.relocalization.errors import NoContrast, NotTrusted, Saturated, SphereNotInView
from procedures.strategies.trajectory import back_along_axis
from procedures.workcell.arm_history import MotionKind
from procedures.workcell.arms import STILL_RAD
from procedures.workcell.device_views import ArmView
from procedures.workcell.errors import SPHERE_NOT_FOUND
from procedures.workcell.stereo_look import Look
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.errors import OutOfJointRange, Unreachable
from ronna_hw.arrays import Array
from ronna_hw.devices.lifecycle import RUNNING
from ronna_hw.errors import LimitError, RonnaError, is_error
from ronna_hw.frames import Transform
from ronna_hw.text import format_count
from ronna_hw.vectors import JointVector

if TYPE_CHECKING:
    from procedures.workcell.workcell import Workcell

SHORTER, LONGER = 0.25, 4.0  # shares of the configured exposure that are tried
# From any side, steps smaller than the backlash end anywhere in it. The residual is recorded with the pose,
# so a larger one costs nothing: backlash of 0.02 deg in every joint displaces the tool by up to 0.4 mm.
WITHIN_BACKLASH = ServoSettings(tolerance_mm=0.5)
SHARES_OF_BACKING_OFF = 1.0, 0.75, 0.5
LIGHT_PROBLEMS = (NoContrast, NotTrusted)  # besides saturation, problems that another exposure may solve


@dataclass(frozen=True)
class CentredSphere:
    """Measured sphere: its centre `point_mm` (3,) in the robot frame, and the servo residuals."""

    fiducial: int
    point_mm: Array
    residuals_mm: tuple[float, ...]
    covariance_mm2: Array  # of the stereo measurement, robot frame
    ray_gap_mm: float
    radii_mm: tuple[float, float]  # as the left and the right camera see it
    looks: int
    joints_rad: JointVector
    last_look: Look


@dataclass(frozen=True)
class Centring:
    """Settings for centring on spheres: arrival side of each joint, sensor area, approach distance.

    With `arriving` None, each joint arrives from any side.
    """

    workcell: Workcell
    arriving: Sequence[int] | None
    area_px: tuple[int, int]
    approach_mm: float
    on_centred: Callable[[int], None] = lambda _fiducial: None  # while the arm still rests there

    def centre_on(
        self, fiducial: int, expected: Transform, near: JointVector, *, is_close: bool = False
    ) -> CentredSphere:
        """Centre the tool on the sphere expected at a pose ROBOT <- TOOL, and measure it.

        The arm goes straight there if that is clear. Else it backs off from another sphere, and approaches
        along the tool axis from the joints `near`. With `is_close`, the sphere is expected within about a
        millimetre: the first look already reads no more of the sensors than the sphere needs.
        Raises PRO-008 if it is not there, STE-011 if the images are saturated, STE-007 and STE-008 if the
        servo does not converge. The arm then rests at the pose of its last look, see `back_off`.
        """
        try:
            self.go_over(expected, near)
            return self._centre_on(fiducial, expected, is_close=is_close)
        finally:
            self.workcell.sensors.expose(1.0)

    def back_off(self) -> None:
        """Back off along the tool axis from the pose of the last look, as far as the joints reach.

        The way was checked from where the look was planned; it may have ended millimetres beside that.
        """
        master = self.workcell.master
        here = master.tool_pose()
        *tried, least = (back_along_axis(here, share * self.approach_mm) for share in SHARES_OF_BACKING_OFF)
        for pose in tried:
            problem = refusal(partial(master.line_to, pose), master.arm)
            if problem is None:
                return
            if not is_error(problem, OutOfJointRange, Unreachable):
                raise problem
        master.line_to(least)

    @property
    def is_over_sphere(self) -> bool:
        """Whether the last motion ended over a sphere, or where one was expected."""
        return self.workcell.master.supervised.ended in (MotionKind.SETTLE, MotionKind.STEP)

    def go_over(self, expected: Transform, near: JointVector) -> None:
        """Move to a pose: straight there if that is clear, else back off and approach along the tool axis."""
        master, over_sphere = self.workcell.master, self.is_over_sphere
        began_rad = master.joints_rad()
        onto_rad = master.joints_at(expected, near, self.arriving)
        if refusal(partial(master.settle, onto_rad, self.arriving), master.arm) is None:
            return
        has_moved = not np.allclose(master.joints_rad(), began_rad, rtol=0.0, atol=STILL_RAD)
        if over_sphere or has_moved:  # the last leg may be the one that was refused
            self.back_off()
        master.go(master.joints_at(self._approach_pose(expected), near))
        master.line_to(expected)
        self._settle(expected)

    def _centre_on(self, fiducial: int, expected: Transform, *, is_close: bool) -> CentredSphere:
        workcell = self.workcell
        if is_close:
            workcell.sensors.read_around_sphere(self.area_px)
        else:
            workcell.sensors.read_around_tool(self.area_px)
        seen, looks = self._first_look(fiducial, expected)
        exact = ServoSettings.for_arm(find_arm(workcell.master.arm.kinematics.name).repeatability_mm)
        servo = ServoState(exact if self.arriving is not None else WITHIN_BACKLASH)
        while True:
            joints = workcell.master.joints_rad()
            pose = workcell.master.tool_pose(joints, self.arriving)
            if seen.point is None:
                raise SPHERE_NOT_FOUND(f"sphere {fiducial + 1} was lost during the servo", got=seen.reason)
            servo = servo.with_measurement(pose, seen.point.position_mm)
            if servo.converged:
                break
            self._settle(servo.next_pose(pose))
            workcell.sensors.read_around_sphere(self.area_px)
            seen, looks = workcell.look(), looks + 1
            if seen.point is None:  # noise may cost one look; a sphere that is hidden or gone stays so
                workcell.sensors.read_whole()
                seen, looks = workcell.look(), looks + 1
        self.on_centred(fiducial)
        rotation = pose.rotation_matrix
        return CentredSphere(
            fiducial=fiducial,
            point_mm=recorded_point(pose, seen.point.position_mm),
            residuals_mm=servo.residuals_mm,
            covariance_mm2=rotation @ seen.point.covariance_mm2 @ rotation.T,
            ray_gap_mm=float(seen.point.ray_gap_mm),
            radii_mm=seen.point.radii_mm,
            looks=looks,
            joints_rad=joints,
            last_look=seen,
        )

    def _first_look(self, fiducial: int, expected: Transform) -> tuple[Look, int]:
        """Look with the area set, then the whole sensors, then in a spiral, then with other exposures."""
        workcell = self.workcell
        try:
            seen, looks = workcell.look(), 1
        except Saturated as error:  # a search would not help
            workcell.sensors.read_around_tool(self.area_px)
            return self._look_in_other_light(1, (SHORTER,), error)
        if seen.point is not None:
            return seen, looks
        workcell.sensors.read_whole()
        seen, looks = workcell.look(), looks + 1
        # the look with the best reason for a refusal: nearest to the place, or with a sphere
        best_look, pose = seen, expected
        poses = search_poses(expected, self._settle, workcell.master.arm)
        try:
            while seen.point is None:
                around = next(poses)
                seen, looks = workcell.look(), looks + 1
                if best_look.left is None and seen.left is not None:
                    best_look, pose = seen, around
        except SphereNotInView as error:
            refusal = SPHERE_NOT_FOUND(
                f"sphere {fiducial + 1} was not found: {error.what}: {best_look.reason}", limit=error.limit
            )
            if not isinstance(best_look.problem, LIGHT_PROBLEMS):
                raise refusal from error
            self._settle(pose)
            return self._look_in_other_light(looks, (LONGER, SHORTER), refusal)
        return seen, looks

    def _look_in_other_light(
        self, looks: int, exposures: Sequence[float], refusal: RonnaError
    ) -> tuple[Look, int]:
        """Look with other exposures. Raises `refusal` if the sphere is not found with any of them."""
        workcell = self.workcell
        for share in exposures:
            workcell.sensors.expose(share)
            try:
                seen, looks = workcell.look(), looks + 1
            except Saturated:
                continue
            if seen.point is not None:
                return seen, looks
        raise refusal

    def _settle(self, pose: Transform) -> None:
        """Move to a pose, each joint arriving from its given side if `arriving` is set."""
        joints_rad = self.workcell.master.joints_at(pose, self.workcell.master.joints_rad(), self.arriving)
        self.workcell.master.settle(joints_rad, self.arriving)

    def _approach_pose(self, pose: Transform) -> Transform:
        return back_along_axis(pose, self.approach_mm)


def search_poses(
    expected: Transform, settle: Callable[[Transform], object], arm: ArmView
) -> Iterator[Transform]:
    """Move through a search pattern around the expected pose, yielding each pose reached.

    The search leaves the checked path: poses refused before the arm moves are skipped. Raises STE-009 after
    the last, and errors that trip the arm.
    """
    skipped_count = 0
    for number in count():
        try:
            pose = search_pose(expected, number)
        except SphereNotInView as error:
            if not skipped_count:
                raise
            what = f"no sphere in {format_count(number - skipped_count, 'image pair')}, "
            what += f"{format_count(skipped_count, 'pose')} not clear"
            raise SphereNotInView(what, limit=error.limit) from error
        if refusal(partial(settle, pose), arm) is None:
            yield pose
        else:
            skipped_count += 1


def refusal(move: Callable[[], object], arm: ArmView) -> LimitError | None:
    """Make a motion; return the error if it, or its last leg, was refused. Raises if the arm trips."""
    try:
        move()
    except LimitError as error:
        if arm.state not in RUNNING:
            raise
        return error
    return None
