"""Guide tip calibration relative to the stereo head, over random arms, heads and stands, in process.

`relative to the head's measurement`: against the position of a ball at the true tip, as seen by the head with
its record. The guide is seated as at the stand: each mounting adds the changer's own repeatability. A case
depends on this error, as it localizes with that head and record. `relative to the true tool centre` also
includes the error of the head's record.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from scipy.spatial.transform import RigidTransform

from benchmarks.figures import Figure
from benchmarks.mount.tracker_frame_calibration import FLANKS, FrameCell, list_error_figures
from benchmarks.stereo_head.head_looks import TrueHead
from procedures.calibration.head_model import cameras_of, intersect_rays, pose_record
from procedures.calibration.pose_set import (
    PlannedLook,
    choose_held_out,
    order_by_orientation,
    plan_poses_about,
)
from procedures.calibration.tip_calibration import (
    BallLook,
    DivotReading,
    TipLooks,
    calibrate_tip,
    pairs_of,
    tips_of,
)
from procedures.strategies.trajectory import tool_orientation
from ronna_hw.arrays import Array
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector
from ronna_hw.wire.room_tasks import OnStand
from sim.world.rigid import inverse, matrix_of
from sim.world.staff import read_dials
from sim.world.true_arm import TrueArm
from sim.world.truth import TrueGuide
from sim.world.world import ArmState, World

TILT_RAD, TURN_RAD = math.radians(25.0), math.radians(40.0)
SPARE = 1.5
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass
class TipCell(FrameCell):
    """A scene with a stand, whose ball the head sees with realistic outline noise."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._arm_truth = TrueArm(self.scene.arm, self.scene.seed)
        self._room = World.create(self.scene, paced=False)
        self._room.mount_tool(self.scene.mount.tool_number_guide)
        self._room.put_on_stand(OnStand.DIVOT)
        self._noise = np.random.default_rng([self.scene.seed, 7])
        self.head = self.calibrations.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)

    def readings(self, count: int, validation: int, tilt_rad: float = TILT_RAD) -> TipLooks:
        """Return looks and readings as the calibration steps would take them."""
        ball = np.round(self.scene.stand.ball_mm)
        reference = tool_orientation(DOWN, ball, 0.0)
        total = count + validation
        planned = plan_poses_about(
            reference, ball, round(SPARE * total), tilt_rad=tilt_rad, turn_rad=TURN_RAD
        )
        reached = {id(one): joints for one in planned if (joints := self._solve_joints(one)) is not None}
        first = [one for one in planned if id(one) in reached][:total]
        looks = [self._look_at_ball(reached[id(one)]) for one in order_by_orientation(first)]
        observed = TipLooks(
            created=datetime.now(UTC),
            arm=self.scene.arm.variant,
            stereo_head=self.calibrations.stereo_head,
            start=self.calibrations.tool_tip,
            arm_record=self.calibrations.arm,
            looks=tuple(looks),
            readings=(),
            validation=choose_held_out(len(looks), validation),
        )
        for number, look in enumerate(looks):
            for _ in range(2):  # the second iteration is close
                others = tuple(one for one in observed.readings if one.look != number)
                reading = self._read_divot(observed, number, look)
                observed = observed.model_copy(update={"readings": (*others, reading)})
        return observed

    @property
    def true_tip_mm(self) -> Array:
        """True tip position of the seated guide in the true tool frame, after a reading."""
        return np.asarray((inverse(self._room.robot_from_tool()) @ TrueGuide(self._room).tip_frame())[:3, 3])

    def seen_mm(self, in_tool_mm: Array, noise_px: float = 0.0) -> Array:
        """Return where the head, using its record, sees a ball given in the true tool frame."""
        eye = TrueHead(self.scene, outline_px=noise_px)
        pixels = [
            eye._outline(
                camera, (matrix_of(camera.camera_from_tool) @ np.append(in_tool_mm, 1.0))[:3], self._noise
            ).centre_px
            for camera in (self.scene.left, self.scene.right)
        ]
        left, right = (np.array([one]) for one in pixels)
        in_flange, _ = intersect_rays(cameras_of(self.calibrations.stereo_head), left, right)
        return self.head.inverse().apply(in_flange[0])

    def _solve_joints(self, look: PlannedLook) -> JointVector | None:
        try:
            return self.arm.compensate(look.pose @ self.head.inverse(), self.home).joints_rad
        except LimitError:
            return None

    def _look_at_ball(self, joints: JointVector) -> BallLook:
        flange = self._flange_at_rest(joints)
        tool = flange @ matrix_of(self.scene.mount.flange_from_tool_true)
        in_tool = (inverse(tool) @ np.append(self.scene.stand.ball_mm, 1.0))[:3]
        x, y, z = self.seen_mm(in_tool, noise_px=0.02).tolist()
        return BallLook(
            joints_rad=joints, robot_from_flange=pose_record(self.arm.flange_pose(joints)), ball_mm=(x, y, z)
        )

    def _read_divot(self, observed: TipLooks, number: int, look: BallLook) -> DivotReading:
        flange = look.robot_from_flange.transform(Frame.ROBOT, Frame.FLANGE)
        guide = observed.start.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
        tip = (self.head.inverse() @ guide).translation_mm
        if observed.readings:
            tip = tips_of(pairs_of(observed, observed.readings)).mean(axis=0)
        ball, rotation = (flange @ self.head).apply(look.ball_mm), flange.rigid.rotation
        origin = ball - rotation.apply(self.head.apply(tip))
        wanted_flange = Transform(Frame.ROBOT, Frame.FLANGE, RigidTransform.from_components(origin, rotation))
        joints = self.arm.compensate(wanted_flange, look.joints_rad).joints_rad
        self._room.publish_arm(ArmState(joints, self._flange_at_rest(joints), self._motions, True))
        return DivotReading(
            look=number,
            joints_rad=joints,
            robot_from_flange=pose_record(self.arm.flange_pose(joints)),
            dials_mm=read_dials(self._room),
        )

    def _flange_at_rest(self, joints: JointVector) -> Array:
        self._motions += 1
        return self._arm_truth.at_rest(joints, FLANKS, self._motions)


SEEDS = 20
READINGS, VALIDATION = 10, 3
WHO = "ronna-procedure calibrate tool-tip"
GOAL_MM = 0.05


def measure(smallest: bool = False) -> list[Figure]:
    seeds = 1 if smallest else SEEDS
    return [*_make_figures(True, seeds), *_make_figures(False, seeds)]


def _make_figures(calibrated: bool, seeds: int) -> list[Figure]:
    rows = np.array([_compute_errors(seed, calibrated) for seed in range(seeds)])
    columns = [(f"relative to the {what}", "mm") for what in ("head's measurement", "true tool centre")]
    named = f"tool tip, {'calibrated arm' if calibrated else 'uncalibrated arm'}"
    return list_error_figures(named, WHO, rows, columns, (GOAL_MM, GOAL_MM), made=0)


def _compute_errors(seed: int, calibrated: bool) -> tuple[float, float, float]:
    """Return the errors relative to the head and to the true tool centre, and the stated error, in mm."""
    cell = TipCell.of(seed, calibrated=calibrated)
    result = calibrate_tip(cell.readings(READINGS, VALIDATION))
    true = cell.true_tip_mm
    found = result.fit.tip_mm
    return (
        float(np.linalg.norm(found - cell.seen_mm(true))),
        float(np.linalg.norm(found - true)),
        result.tool_tip.stated_error_mm,
    )
