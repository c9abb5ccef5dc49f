"""Calibration of the tracked reference frame on the mount, over random arms and trackers, in process.

Two references. `as on this arm` is the result of an error-free tracker with the same arm and record:
the error of the procedure itself. `as designed` is the position on the flange in the scene; it differs
from the first by the error of the arm's last links. No measurement with that arm can distinguish this error
from a shift of the frame, and it cancels in every use of the record with the arm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.figures import Figure
from benchmarks.stereo_head.head_looks import ENDPOINTS
from procedures.calibration.frame_calibration import (
    FrameLook,
    FrameLooks,
    Use,
    assign_uses,
    calibrate_frame,
    frame_poses,
    pairs_of,
)
from procedures.calibration.hand_eye import solve
from procedures.calibration.head_model import pose_record
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.arm import CalibratedArm
from ronna_hw.calibrated_arm.deviations import ArmDeviations
from ronna_hw.calibration import PoseRecord
from ronna_hw.config import Calibrations, parse_theatre
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector
from ronna_hw.wire.polaris import SystemStatus
from sim.polaris.measurement.frame import Measurer
from sim.polaris.unit.model import EXTENDED_PYRAMID, PYRAMID
from sim.polaris.unit.ports import Port
from sim.polaris.unit.tool_definition import parse_definition, write_definition
from sim.theatre.theatre_file import theatre_content
from sim.world.rigid import inverse, matrix_of
from sim.world.scene.model import ArmResidual, Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import TrueArm
from sim.world.world import ArmState, World

FRAMES = 60
FLANKS = (1.0,) * 6  # every joint arrives turning in the same direction
SPARE = 1.5


@dataclass
class FrameCell:
    """The arm and tracker of a scene. With `exact`, the tracker is error-free."""

    scene: Scene
    calibrations: Calibrations
    exact: bool = False

    @classmethod
    def of(cls, seed: int, *, calibrated: bool, exact: bool = False) -> Self:
        """Build the cell from the default scene of a seed, with or without a calibrated arm."""
        scene = draw_scene("default", seed=seed)
        if calibrated:
            error = scene.calibration_error.model_copy(update={"arm": ArmResidual()})
            scene = scene.model_copy(update={"calibration_error": error})
        calibrations = parse_theatre(theatre_content(scene, ENDPOINTS, "host:", {}, 1.0)).calibration
        assert calibrations is not None
        return cls(scene, calibrations, exact)

    def __post_init__(self) -> None:
        kinematics, record = kr6_r900(self.scene.arm.variant), self.calibrations.arm
        self.arm = CalibratedArm(kinematics, ArmDeviations.of(record) if record else None)
        self._true = TrueArm(self.scene.arm, self.scene.seed)
        self._world = World.create(self.scene, paced=False)
        self._measurer = Measurer(self._world, (PYRAMID, EXTENDED_PYRAMID))
        definition = parse_definition(write_definition(self.scene.tracker.tools[0]))
        self._port = Port(handle=1, definition=definition, initialised=True, enabled=True)
        self._motions = 0
        a, b, c, d, e, f = (math.radians(angle) for angle in self.scene.arm.home_deg)
        self.home: JointVector = (a, b, c, d, e, f)

    @property
    def true_frame(self) -> Array:
        mount = self.scene.mount
        return matrix_of(mount.flange_from_tool_true) @ matrix_of(mount.tool_from_marker_true)

    def looks(self, count: int, validation: int, returns: int = 2) -> FrameLooks:
        head = self.calibrations.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
        frame = self.calibrations.tracker_frame.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
        reference = self.arm.flange_pose(self.home) @ head
        seen: list[FrameLook] = []
        uses = assign_uses(count, validation)
        for planned in frame_poses(reference, frame, round(SPARE * len(uses))):
            if len(seen) == len(uses):
                break
            try:
                joints = self.arm.compensate(planned.pose @ head.inverse(), self.home).joints_rad
            except LimitError:
                continue
            look = self._take_look(joints, uses[len(seen)])
            if look is not None:
                seen.append(look)
        return_looks = [
            look for _ in range(returns) if (look := self._take_look(self.home, Use.RETURN)) is not None
        ]
        return FrameLooks(
            created=datetime.now(UTC),
            arm=self.scene.arm.variant,
            stereo_head=self.calibrations.stereo_head,
            start=self.calibrations.tracker_frame,
            arm_record=self.calibrations.arm,
            looks=(*seen, *return_looks),
        )

    def _take_look(self, joints: JointVector, use: Use) -> FrameLook | None:
        self._motions += 1
        flange = self._true.at_rest(joints, FLANKS, self._motions)
        if self.exact:
            tracker = inverse(matrix_of(self.scene.tracker.robot_from_tracker))
            seen: PoseRecord | None = _make_record(
                tracker @ flange @ self.true_frame, Frame.TRACKER, Frame.MARKER
            )
        else:
            self._world.publish_arm(ArmState(joints, flange, self._motions, True))
            seen = self._measure_frame()
        if seen is None:
            return None
        return FrameLook(
            use=use,
            joints_rad=joints,
            robot_from_flange=pose_record(self.arm.flange_pose(joints)),
            tracker_from_marker=seen,
            frames=FRAMES,
        )

    def _measure_frame(self) -> PoseRecord | None:
        self._measurer.begin_tracking()
        self._measurer.forget_tools()
        poses = []
        for number in range(FRAMES):
            frame = self._measurer.frame(number, number, (self._port,), PYRAMID, SystemStatus(0))
            ((_, tracked),) = frame.tools
            if tracked is not None and tracked.pose is not None:
                poses.append(tracked.pose)
        if len(poses) < FRAMES // 2:
            return None
        mean = np.eye(4)
        turns = Rotation.from_quat([one.quaternion for one in poses], scalar_first=True)
        mean[:3, :3] = turns.mean().as_matrix()
        mean[:3, 3] = np.mean([one.position_mm for one in poses], axis=0)
        return _make_record(mean, Frame.TRACKER, Frame.MARKER)


def _make_record(matrix: Array, target: Frame, source: Frame) -> PoseRecord:
    return pose_record(Transform.from_matrix(target, source, matrix))


SEEDS = 20
LOOKS, VALIDATION = 30, 10
WHO = "ronna-procedure calibrate tracker-frame"
GOAL_MM, GOAL_DEG = 0.15, 0.05


def measure(smallest: bool = False) -> list[Figure]:
    seeds = 1 if smallest else SEEDS
    return [*_make_figures(True, seeds), *_make_figures(False, seeds)]


def _make_figures(calibrated: bool, seeds: int) -> list[Figure]:
    rows = np.array([_compute_errors(seed, calibrated) for seed in range(seeds)])
    columns = [(what, unit) for what in ("as on this arm", "as designed") for unit in ("mm", "°")]
    named = f"tracker frame, {'calibrated arm' if calibrated else 'uncalibrated arm'}"
    return list_error_figures(named, WHO, rows, columns, (GOAL_MM, GOAL_DEG), made=2)


def list_error_figures(
    named: str,
    who: str,
    rows: Array,
    columns: Sequence[tuple[str, str]],
    goals: Sequence[float],
    *,
    made: int,
) -> list[Figure]:
    """List the errors by column of the rows, with what they are relative to and their unit.

    Goals apply to the largest errors of the first columns. Behind the errors stands the stated one, to which
    that of the column `made` is compared.
    """
    figures = []
    for number, (what, unit) in enumerate(columns):
        largest = Figure(f"{named}: largest error, {what}", who, float(rows[:, number].max()), unit)
        figures.append(largest.at_most(goals[number]) if number < len(goals) else largest)
        rms = float(np.sqrt(np.mean(rows[:, number] ** 2)))
        figures.append(Figure(f"{named}: rms error, {what}", who, rms, unit))
    ratio = float(np.sqrt(np.mean((rows[:, made] / rows[:, len(columns)]) ** 2)))
    return [*figures, Figure(f"{named}: made over stated error", who, ratio, "")]


def _compute_errors(seed: int, calibrated: bool) -> tuple[float, float, float, float, float]:
    """Return the errors (mm, deg) relative to an exact calibration and to the truth, and the stated error."""
    cell = FrameCell.of(seed, calibrated=calibrated)
    result = calibrate_frame(cell.looks(LOOKS, VALIDATION))
    found = result.fit.flange_from_marker
    exact = FrameCell.of(seed, calibrated=calibrated, exact=True).looks(LOOKS, VALIDATION)
    as_arm_has_it = solve(pairs_of([one for one in exact.looks if one.use is not Use.RETURN]))
    own = pose_difference(found, as_arm_has_it.flange_from_marker)
    return (*own, *pose_difference(found, cell.true_frame), result.tracker_frame.stated_error_mm)


def pose_difference(one: Array, other: Array) -> tuple[float, float]:
    turn = Rotation.from_matrix(one[:3, :3].T @ other[:3, :3]).magnitude()
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3])), float(np.degrees(turn))
