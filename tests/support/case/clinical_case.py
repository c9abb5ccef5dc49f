"""A clinical case on the truth of a scene: its arm, and a tracker and a stereo head that see the spheres."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from recording_cell import GUIDE, STAMP, STEREO_HEAD, RecordingCell, RecordingTracker, theatre_of
from scipy.spatial.transform import Rotation

from procedures.engine.case import Stored
from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.order import Outcome, Phase, Scope, StepSpec, order_of
from procedures.journal.results import StepResult
from procedures.operator.question import Answer, Question, Topic
from procedures.relocalization import StereoPoint
from procedures.relocalization.errors import NoSphere
from procedures.relocalization.outline import SphereImage, SphereStatus
from procedures.steps.catalogue import CLINICAL_STEPS, list_questions
from procedures.workcell import MountedTool, Workcell
from procedures.workcell.arm_history import ArmHistory
from procedures.workcell.stereo_look import Look
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3, Numbers4, PoseRecord
from ronna_hw.config import Calibrations, TheatreFile
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import StereoReading, StrayReading, ToolReading, TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform
from ronna_hw.roles import MASTER
from ronna_hw.vectors import JointVector
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.parts import GUIDE_FRAME_NAME as GUIDE_FRAME

SCENE = draw_scene("mini", seed=3, markers=4, targets=2)
TRAJECTORIES = tuple(target.identifier for target in SCENE.head.targets)
FIRST, LAST = TRAJECTORIES
ROBOT_FROM_CT = SCENE.head.robot_from_ct.transform(Frame.ROBOT, Frame.CT)
CENTRES_CT_MM = np.array([fiducial.centre_ct_mm for fiducial in SCENE.head.fiducials])
SPHERES_MM = ROBOT_FROM_CT.apply(CENTRES_CT_MM)
THEATRE = theatre_of(SCENE)
A1, A2, A3, A4, A5, A6 = (math.radians(angle) for angle in SCENE.arm.home_deg)
TRACKER_MM: Numbers3 = SCENE.tracker.robot_from_tracker.translation_mm
HOME_RAD: JointVector = (A1, A2, A3, A4, A5, A6)
IN_VIEW_MM = 12.0  # of the tool centre: what lies farther away is outside both pictures
SIGMA_MM = 0.01  # per axis, of a sphere in the CT or before the stereo head
CLINICAL_NAMES = {step.name for step in CLINICAL_STEPS}
ANYWHERE = (Topic.PAUSE, Topic.GUARD, Topic.UNVERIFIED)  # what any step may meet
NO_PICTURES = StereoReading(STAMP, Validity.OK, None, None)
OUTLINE = SphereImage(
    centre_px=(1024.0, 544.0),
    axes_px=(120.0, 119.0),
    quality=1.0,
    status=SphereStatus.OK,
    covariance_px2=((1e-4, 0.0), (0.0, 1e-4)),
    rim_fraction=1.0,
    scatter_px=0.1,
    blur_px=1.0,
)


class SeeingWorkcell(Workcell):
    """A workcell that sees the sphere nearest to the tool centre where it is, without pictures."""

    spheres_mm: Array
    radii_mm = (5.75, 5.75)  # as the left and the right camera see them

    def look(self) -> Look:
        master = self.master
        head = master.arm.kinematics.flange_pose(master.joints_rad())
        head = head @ master.flange_from(MountedTool.STEREO_HEAD)
        seen_mm = head.inverse().apply(self.spheres_mm)
        nearest = seen_mm[np.linalg.norm(seen_mm, axis=1).argmin()]
        if np.linalg.norm(nearest) > IN_VIEW_MM:
            return Look(NO_PICTURES, None, None, None, NoSphere("no sphere in view"))
        point = StereoPoint(nearest, np.eye(3) * SIGMA_MM**2, 0.001, self.radii_mm)
        return Look(NO_PICTURES, OUTLINE, OUTLINE, point)


@dataclass
class SeeingTracker(RecordingTracker):
    """A tracker above the head, its axes along the robot's; sees the frame on the arm and all spheres."""

    tools: tuple[str, ...] = tuple(tool.name for tool in SCENE.tracker.tools)
    cell: ClinicalCell | None = None
    spheres_mm: Array = field(default_factory=SPHERES_MM.copy)
    frame_shift_mm: Numbers3 = (0.0, 0.0, 0.0)
    frame_turn_rad: Numbers3 = (0.0, 0.0, 0.0)  # about its own place
    hidden: bool = False  # the frame
    guide_shift_mm: Numbers3 | None = (0.0, 0.0, 0.0)  # of the frame on the guide; None: not seen
    frames_read: int = 0
    replies_s: tuple[float, ...] = ()

    @property
    def markers_mm(self) -> dict[str, tuple[Numbers3, ...]]:
        return {tool.name: tool.markers_mm for tool in SCENE.tracker.tools}

    def read_frame(self, timeout_s: float = 1.0) -> TrackerFrame:
        assert self.cell is not None
        self.frames_read += 1
        records = self.cell.calibrations
        if self.hidden:
            reading = ToolReading(records.tracker_frame.tool, Validity.MISSING, None, None, None)
        else:
            pose = _frame_on_the_arm(
                self.cell.arm.kinematics,
                self.cell.arm.joints_rad,
                records.stereo_head.flange_from_tool,
                records.tracker_frame.tool_from_marker,
                self.frame_shift_mm,
                turn_rad=self.frame_turn_rad,
            )
            reading = ToolReading(records.tracker_frame.tool, Validity.OK, *pose, 0.1)
        strays = tuple(
            StrayReading((x, y, z), Validity.OK) for x, y, z in (self.spheres_mm - TRACKER_MM).tolist()
        )
        return TrackerFrame(STAMP, Validity.OK, (reading, self._on_guide(self.cell)), strays)

    def _on_guide(self, cell: ClinicalCell) -> ToolReading:
        """The frame on the guide, while that is mounted."""
        frame, records = cell.workcell.tools.guide.record.frame, cell.calibrations
        assert frame is not None
        if self.guide_shift_mm is None or cell.arm.mounted != GUIDE:
            return ToolReading(GUIDE_FRAME, Validity.MISSING, None, None, None)
        pose = _frame_on_the_arm(
            cell.arm.kinematics,
            cell.arm.joints_rad,
            records.stereo_head.flange_from_tool,
            records.tracker_frame.tool_from_marker,
            self.guide_shift_mm,
            frame.mount_from_frame,
        )
        return ToolReading(GUIDE_FRAME, Validity.OK, *pose, 0.1)


@lru_cache(maxsize=4)  # an arm at rest is seen in one frame after the other
def _frame_on_the_arm(
    kinematics: Kinematics,
    joints_rad: JointVector,
    flange_from_tool: PoseRecord,
    tool_from_marker: PoseRecord,
    shift_mm: Numbers3,
    mount_from_frame: PoseRecord | None = None,
    turn_rad: Numbers3 = (0.0, 0.0, 0.0),
) -> tuple[Numbers4, Numbers3]:
    """Rotation and place, for the tracker, of the tracked frame on the mount or of one fixed to it, in mm."""
    tool = flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    marker = tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
    if mount_from_frame is not None:
        marker = marker @ mount_from_frame.transform(Frame.MARKER, Frame.MARKER)
    pose = shifted(kinematics.flange_pose(joints_rad) @ tool @ marker, shift_mm)
    turned = Rotation.from_rotvec(turn_rad) * Rotation.from_matrix(pose.rotation_matrix)
    w, qx, qy, qz = turned.as_quat(scalar_first=True).tolist()
    x, y, z = (pose.translation_mm - TRACKER_MM).tolist()
    return (w, qx, qy, qz), (x, y, z)


@dataclass
class ClinicalCell(RecordingCell):
    """The recording cell over the scene, with the spheres where they are."""

    theatre: TheatreFile = field(default_factory=lambda: THEATRE)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.arm.joints_rad = HOME_RAD
        self.room.touched = head_point
        self.tracker = self.opened.replace_tracker(SeeingTracker("tracker", cell=self))

    def make_workcell(
        self, calibrations: Calibrations | None = None, history: ArmHistory | None = None
    ) -> SeeingWorkcell:
        workcell = SeeingWorkcell(
            self.opened, self.journal, calibrations=calibrations, histories={MASTER: history or ArmHistory()}
        )
        workcell.spheres_mm = SPHERES_MM.copy()
        return workcell

    def carrying(self, tool: MountedTool) -> ClinicalCell:
        """After the set-up, with that tool mounted and checked."""
        self.arm.state = self.stereo.state = self.tracker.state = Lifecycle.CONFIGURED
        self.arm.mounted = GUIDE if tool is MountedTool.GUIDE else STEREO_HEAD
        self.workcell.master.mount.check(tool)
        self.workcell.master.set_home()
        return self

    def settled(self) -> ClinicalCell:
        """The arm has come home with every joint from the same side, as a check of the tool leaves it."""
        self.workcell.start()
        self.workcell.master.return_home()
        self.workcell.rest()
        self.arm.motions.clear()
        return self

    def begin(self, *steps: StepSpec[StepResult] | StepResult) -> Engine:
        """An engine for these steps; for a result, a step that leaves it."""
        specs = [given(step) if isinstance(step, StepResult) else step for step in steps]
        once = not self.strategy.localizes_per_trajectory
        engine = self.engine(order_of(specs, TRAJECTORIES, localizes_per_trajectory=not once))
        ask = engine.questions.ask

        def only_planned(question: Question) -> Answer:
            if engine.running is not None and engine.running.name in CLINICAL_NAMES:
                planned = list_questions(engine.order.spec(engine.running))
                assert question.topic in {*ANYWHERE, *(one.topic for one in planned)}, str(engine.running)
            return ask(question)

        engine.questions.ask = only_planned  # type: ignore[method-assign]
        return engine

    def run(self, *steps: StepSpec[StepResult] | StepResult) -> Stored[StepResult]:
        """Run these steps; of the last one, for its first trajectory, the result."""
        engine = self.begin(*steps)
        last = next(key for key in engine.order.sequence if key.name == engine.order.steps[-1].name)
        engine.run_to(last)
        return self.case.get(engine.order.spec(last).result, last.trajectory)


def head_point(side: tuple[float, ...]) -> tuple[float, ...]:
    """Where the head's skin is on that side, LPS, in the robot frame."""
    skin_ct_mm = np.array(SCENE.head.centre_ct_mm) + np.array(SCENE.head.semi_axes_mm) * side
    return tuple(ROBOT_FROM_CT.apply(skin_ct_mm).tolist())


def given(result: StepResult, *reads: type[StepResult]) -> StepSpec[StepResult]:
    """A step that leaves this result, made from what it reads."""

    def run(context: StepContext) -> Outcome[StepResult]:
        for model in reads:
            context.result(model)
        return Outcome(result)

    return StepSpec(type(result), "given", Phase.PREOPERATIVE, run, reads=reads)


def done_later(
    result: StepResult, *reads: type[StepResult], scope: Scope = Scope.CASE, finishes: bool = False
) -> StepSpec[StepResult]:
    """As `given`, of what the place of the cart matters to."""
    return replace(given(result, *reads), phase=Phase.OPERATION, scope=scope, finishes=finishes)


def shifted(pose: Transform, by_mm: Numbers3) -> Transform:
    """The same pose, moved in its target frame."""
    return Transform.of(
        pose.target,
        pose.source,
        translation_mm=pose.translation_mm + by_mm,
        quaternion_wxyz=pose.quaternion_wxyz,
    )
