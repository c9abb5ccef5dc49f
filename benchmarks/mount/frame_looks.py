"""Readings of the true frame on a true arm by a true tracker, made in process without protocols: for studies.

Uses the unit's own measurement frame by frame: marker noise, the smooth bias of the volume, occlusion by head
and arm, the fit of the definition.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.stereo_head.head_looks import ENDPOINTS
from procedures.calibration.frame_calibration import FrameLook, FrameLooks, Use, assign_uses, frame_poses
from procedures.calibration.head_model import pose_record
from ronna_hw.arm.calibrated import CalibratedArm
from ronna_hw.arm.deviations import ArmDeviations
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.calibration import PoseRecord
from ronna_hw.config import Calibrations, parse_theatre
from ronna_hw.devices.readings import JointVector
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.wire.polaris import SystemStatus
from sim.polaris.measurement.frame import Measurer
from sim.polaris.optics.measuring_volume import EXTENDED_PYRAMID, PYRAMID
from sim.polaris.tools.definition import parse_definition, write_definition
from sim.polaris.tools.ports import Port
from sim.theatre.theatre_file import theatre_content
from sim.world.arm.true_arm import TrueArm
from sim.world.rigid import inverse, matrix_of
from sim.world.scene.model import ArmResidual, Scene
from sim.world.scene.named_scenes import named_scene
from sim.world.world import ArmState, World

Array = NDArray[np.float64]

FRAMES = 60
FLANKS = (1.0,) * 6  # every joint arrives turning in the same direction
SPARE = 1.5


@dataclass
class FrameCell:
    """A scene's arm and tracker. With `exact` the tracker measures without any error."""

    scene: Scene
    calibrations: Calibrations
    exact: bool = False

    @classmethod
    def of(cls, seed: int, *, calibrated: bool, exact: bool = False) -> FrameCell:
        """The default scene of a seed, with or without a calibrated arm."""
        scene = named_scene("default", seed=seed)
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
        """FLANGE <- MARKER (4, 4)."""
        mount = self.scene.mount
        return matrix_of(mount.flange_from_tool_true) @ matrix_of(mount.tool_from_marker_true)

    def looks(self, count: int, validation: int, returns: int = 2) -> FrameLooks:
        """Readings as taken by the step."""
        head = self.calibrations.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
        frame = self.calibrations.tracker_frame.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
        reference = self.arm.flange_pose(self.home) @ head
        seen: list[FrameLook] = []
        uses = assign_uses(count, validation)
        for planned in frame_poses(reference, frame, round(SPARE * len(uses))):
            if len(seen) == len(uses):
                break
            try:
                joints = self.arm.compensated(planned.pose @ head.inverse(), self.home).joints_rad
            except LimitError:
                continue
            look = self._look(joints, uses[len(seen)])
            if look is not None:
                seen.append(look)
        back = [look for _ in range(returns) if (look := self._look(self.home, Use.RETURN)) is not None]
        return FrameLooks(
            created=datetime.now(UTC),
            arm=self.scene.arm.variant,
            stereo_head=self.calibrations.stereo_head,
            start=self.calibrations.tracker_frame,
            arm_record=self.calibrations.arm,
            looks=(*seen, *back),
        )

    def _look(self, joints: JointVector, use: Use) -> FrameLook | None:
        self._motions += 1
        flange = self._true.at_rest(joints, FLANKS, self._motions)
        if self.exact:
            tracker = inverse(matrix_of(self.scene.tracker.robot_from_tracker))
            seen: PoseRecord | None = _record(tracker @ flange @ self.true_frame, Frame.TRACKER, Frame.MARKER)
        else:
            self._world.publish_arm(ArmState(joints, flange, self._motions, True))
            seen = self._measured()
        if seen is None:
            return None
        return FrameLook(
            use=use,
            joints_rad=joints,
            robot_from_flange=pose_record(self.arm.flange_pose(joints)),
            tracker_from_marker=seen,
            frames=FRAMES,
        )

    def _measured(self) -> PoseRecord | None:
        self._measurer.begin_tracking()
        self._measurer.forget_tools()
        poses = []
        for number in range(FRAMES):
            ((_, tracked),) = self._measurer.frame(
                number, number, (self._port,), PYRAMID, SystemStatus(0)
            ).tools
            if tracked is not None and tracked.pose is not None:
                poses.append(tracked.pose)
        if len(poses) < FRAMES // 2:
            return None
        mean = np.eye(4)
        mean[:3, :3] = (
            Rotation.from_quat([one.quaternion for one in poses], scalar_first=True).mean().as_matrix()
        )
        mean[:3, 3] = np.mean([one.position_mm for one in poses], axis=0)
        return _record(mean, Frame.TRACKER, Frame.MARKER)


def _record(matrix: Array, target: Frame, source: Frame) -> PoseRecord:
    return pose_record(Transform.from_matrix(target, source, matrix))
