"""A workcell over devices that do at once what they are told, and write it down."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, cast

import tomli_w

from drivers.ndi_polaris.measuring_volume import PUBLISHED_VOLUMES
from procedures.engine.case import Case
from procedures.engine.engine import Engine
from procedures.engine.methods import CaseMethods
from procedures.engine.order import CaseOrder
from procedures.engine.setting import CaseSetting, ClinicalInput
from procedures.journal.journal import JOURNAL_FILE, Journal, read_journal
from procedures.operator.checkpoint import Checkpoint
from procedures.operator.question import Answer, Question, Task, Topic
from procedures.strategies.catalogue import find_strategy
from procedures.strategies.strategy import Strategy
from procedures.workcell import Workcell
from procedures.workcell.arm_history import ArmHistory
from ronna_hw.arm.errors import NotClear
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.limits import MotionLimits, working_limits
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.arm.pose import Pose
from ronna_hw.clock import HostClock
from ronna_hw.config import Calibrations, ProcedureSettings, TheatreFile, parse_theatre
from ronna_hw.devices.errors import MotionInterrupted, WrongState
from ronna_hw.devices.lifecycle import Identity, LastKnown, Lifecycle
from ronna_hw.devices.readings import (
    AreaOfInterest,
    ArmReading,
    LinkStatistics,
    Stamp,
    ToolIdentity,
    Validity,
)
from ronna_hw.devices.robot import JointMove, LineMove, Motion, OperatingMode
from ronna_hw.devices.sensors import VolumeSections
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform
from ronna_hw.registry import make_device
from ronna_hw.roles import ASSISTANT, MASTER
from ronna_hw.theatre import DriverOfTable, Theatre
from ronna_hw.vectors import JointVector
from ronna_hw.wire.polaris import PolarisModel
from ronna_hw.wire.room_tasks import DEPTH_STOP, DIALS, GAUGE, TOUCH
from sim.theatre.theatre_file import theatre_content
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene

ENDPOINTS = {
    "polaris": "tcp://127.0.0.1:8765",
    "kuka": {"rsi": "udp://127.0.0.1:59152", "eki_project": "tcp://127.0.0.1:54602"},
    "basler": {"left": "gev://127.77.0.1", "right": "gev://127.77.0.2"},
}
STEREO_HEAD, GUIDE = 1, 2
A1, A2, A3, A4, A5, A6 = (math.radians(angle) for angle in (0.0, -90.0, 90.0, 0.0, 60.0, 0.0))
HOME: JointVector = (A1, A2, A3, A4, A5, A6)
STAMP = Stamp(1, 0, 0.0)


def theatre_of(scene: Scene) -> TheatreFile:
    """The theatre file of a scene, with endpoints at which nothing is."""
    return parse_theatre(theatre_content(scene, ENDPOINTS, "host:", {}, 1.0))


@cache
def mini_theatre() -> TheatreFile:
    """The theatre file of the mini scene."""
    return theatre_of(draw_scene("mini", seed=3))


def mini_theatre_file(folder: Path, *, simulated: bool) -> Path:
    """That theatre as a file in the folder; if not `simulated`, its devices are at network addresses."""
    text = tomli_w.dumps(theatre_content(draw_scene("mini", seed=3), ENDPOINTS, "host:", {}, 1.0))
    path = folder / "theatre.toml"
    path.write_text(text if simulated else text.replace("127.", "172."))
    return path


@dataclass
class RecordingDevice:
    """A device that connects, is configured and activated, and notes it."""

    name: str
    state: Lifecycle = Lifecycle.DISCONNECTED
    notices: tuple[str, ...] = ()
    calls: list[str] = field(default_factory=list)

    def connect(self, timeout_s: float = 10.0) -> Identity:
        self.state = Lifecycle.CONNECTED
        return Identity("Test", f"a {self.name}", "1", "0")

    def configure(self, timeout_s: float = 10.0) -> None:
        self.state = Lifecycle.CONFIGURED

    def activate(self, timeout_s: float = 10.0) -> None:
        self.calls.append("activate")
        self.state = Lifecycle.ACTIVE

    def deactivate(self, timeout_s: float = 10.0) -> None:
        self.calls.append("deactivate")
        self.state = Lifecycle.CONFIGURED

    def observe(self) -> LastKnown[object]:
        return LastKnown(self.state, None, None)

    def close(self) -> None:
        self.state = Lifecycle.CLOSED


@dataclass
class RecordingTracker(RecordingDevice):
    """The tracker, with the tools that it was told to load."""

    tools: tuple[str, ...] = ()
    volume_sections_mm: VolumeSections = PUBLISHED_VOLUMES[PolarisModel.SPECTRA].sections_mm


@dataclass
class RecordingStereo(RecordingDevice):
    """The stereo head: notes which parts of its sensors are read."""

    serials: tuple[str, str] = ("", "")
    areas: list[AreaOfInterest] = field(default_factory=list)

    def set_areas(self, left: AreaOfInterest, right: AreaOfInterest, timeout_s: float = 2.0) -> None:
        self.areas.append(left)


@dataclass
class RecordingArm(RecordingDevice):
    """The arm: every motion arrives at once. `blocked` says which moves are not clear."""

    joints_rad: JointVector = HOME
    mounted: int = STEREO_HEAD
    stops: int = 0
    motions: list[tuple[str, JointVector]] = field(default_factory=list)
    blocked: Callable[[JointVector, JointVector], bool] = lambda _start, _target: False
    failing: RonnaError | None = None
    interruptions: int = 0  # motions still to be stopped half way, by somebody else
    kinematics: Any = field(default_factory=kr6_r900)
    operating_mode: OperatingMode = OperatingMode.AUTOMATIC

    def limits(self, mode: OperatingMode | None = None) -> MotionLimits:
        return working_limits(self.kinematics)

    def read_state(self, timeout_s: float = 1.0) -> ArmReading:
        return ArmReading(STAMP, Validity.OK, self.joints_rad, self.joints_rad, moving=False)

    def observe(self) -> LastKnown[ArmReading]:
        return LastKnown(self.state, None, self.read_state())

    def read_tool_identity(self, timeout_s: float = 1.0) -> ToolIdentity:
        return ToolIdentity(STAMP, self.mounted)

    def link_statistics(self) -> LinkStatistics:
        return LinkStatistics(1, 0, 0, 0, 1.0, 2.0, (0.0, 1.0), (1,), jitter_counts=(0,))

    def surround(self, surroundings: object) -> None:
        self.calls.append("surround")

    def move(self, motion: Motion, **_more: Any) -> ArmReading:
        return self.move_joints(motion) if isinstance(motion, JointMove) else self.move_line(motion)

    def move_joints(self, motion: JointMove) -> ArmReading:
        target_rad = motion.target_rad
        self._begin()
        if self.blocked(self.joints_rad, target_rad):
            raise NotClear("the way is not clear")
        self._be_stopped(target_rad)
        self.motions.append(("joints", target_rad))
        self.joints_rad = target_rad
        return self.read_state()

    def move_line(self, motion: LineMove) -> ArmReading:
        target, flange_from_tool = motion.target, motion.flange_from_tool
        self._begin()
        flange = target if flange_from_tool is None else target @ flange_from_tool.inverse()
        branch = self.kinematics.branch_of(self.joints_rad)
        goal = self.kinematics.solve_branch(Pose.from_transform(flange), branch, self.joints_rad)
        self._be_stopped(goal)
        self.joints_rad = goal
        self.motions.append(("line", self.joints_rad))
        return self.read_state()

    def _begin(self) -> None:
        if self.failing is not None:
            raise self.failing
        if self.state is Lifecycle.HOLD:
            raise WrongState("a motion is not allowed in hold")

    def _be_stopped(self, goal: JointVector) -> None:
        if self.interruptions or self.state is Lifecycle.HOLD:
            self.interruptions = max(self.interruptions - 1, 0)
            self.state = Lifecycle.HOLD
            A1, A2, A3, A4, A5, A6 = ((now + to) / 2 for now, to in zip(self.joints_rad, goal, strict=True))
            self.joints_rad = (A1, A2, A3, A4, A5, A6)
            raise MotionInterrupted("stopped before its end")

    def resume(self) -> None:
        self.calls.append("resume")
        self.state = Lifecycle.ACTIVE

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        self.calls.append(f"recovered by {acknowledged_by}")
        self.state, self.failing = Lifecycle.CONFIGURED, None

    def preview(self, motion: Motion, *, start_rad: JointVector | None = None) -> PathPreview:
        return PathPreview(
            duration_s=1.0,
            joint_ranges_rad=tuple((joint, joint) for joint in self.joints_rad),
            closest=None,
            refused=None,
            singularity=self.kinematics.singular_measure(self.joints_rad),
            largest_joint_speed_share=0.5,
            largest_speed_mm_s=100.0,
            nearest_to_head_mm=None,
        )

    def stop(self, *_kind: object) -> None:
        self.stops += 1
        if self.state is Lifecycle.ACTIVE:
            self.state = Lifecycle.HOLD


class RecordingOperator:
    """Goes on, or by `refusing` some topics answers these as silence would; remembers the questions.

    `answers` has the words for some topics; `meanwhile` is called with every question before its answer.
    """

    def __init__(self, *refusing: Topic) -> None:
        self.refusing = refusing
        self.asked: list[Question] = []
        self.answers: dict[Topic, str] = {}
        self.meanwhile: Callable[[Question], object] = lambda _question: None

    def ask(self, question: Question) -> Answer:
        self.asked.append(question)
        self.meanwhile(question)
        if question.topic in self.refusing:
            return Answer(question.silence)
        return Answer(self.answers.get(question.topic, question.answers[0]))

    def word(self, question: Question) -> str:
        """The word of the answer, as the engine passes it on."""
        return self.ask(question).word


@dataclass
class RecordingRoom:
    """Changes tools on the arm, does what it is told, and remembers all that."""

    arm: RecordingArm
    mounts: int | None = None  # in place of what is asked for
    announced: list[str] = field(default_factory=list)
    stand: list[str] = field(default_factory=list)  # what it was to hold, in turn
    dials: Callable[[JointVector], tuple[float, float, float]] = lambda _joints: (0.0, 0.0, 0.0)
    changed: list[tuple[int, Lifecycle, JointVector]] = field(default_factory=list)
    worked: list[Task] = field(default_factory=list)
    dials_mm: tuple[float, ...] = (0.0,) * 5  # of the gauge
    touched: Callable[[tuple[float, ...]], tuple[float, ...]] = lambda _side: ()  # of the head, on that side
    stop_off_mm: float = 0.0  # by which a depth stop is set beside what was asked for

    def announce(self, step: str) -> None:
        self.announced.append(step)

    def change_tool(self, number: int, description: str) -> None:
        self.changed.append((number, self.arm.state, self.arm.joints_rad))
        self.arm.mounted = number if self.mounts is None else self.mounts

    def prepare_stand(self, holds: str) -> None:
        self.stand.append(holds)

    def work(self, task: Task) -> tuple[float, ...]:
        self.worked.append(task)
        if task.name == DIALS:
            return self.dials(self.arm.joints_rad)
        if task.name == GAUGE:
            return self.dials_mm
        if task.name == DEPTH_STOP:
            return (task.numbers[0] + self.stop_off_mm,)
        if task.name == TOUCH:
            return self.touched(task.numbers)
        return ()


class RecordingTheatre(Theatre):
    """A theatre whose devices are given; those of other kinds are made as in any theatre."""

    def __init__(
        self, file: TheatreFile, arm: Any, stereo: Any, tracker: Any, make: DriverOfTable = make_device
    ) -> None:
        super().__init__(file, HostClock(), make)
        self._devices.update({"robot.master": arm, "stereo": stereo, "tracker": tracker})

    def _get_device_as(self, name: str, interface: Callable[..., Any]) -> Any:
        return self._devices[name] if name in self._devices else super()._get_device_as(name, interface)

    def replace_device(self, name: str, device: Any) -> Any:
        """Put a device in place of the one of this name, and return it."""
        self._devices[name] = device
        return device

    def replace_tracker(self, tracker: Any) -> Any:
        """Put another tracker in its place, and return it."""
        return self.replace_device("tracker", tracker)

    def stop(self) -> list[str]:
        arm = cast("RecordingArm", self._devices["robot.master"])
        if arm.state is Lifecycle.ACTIVE:
            arm.stop()
        return []


@dataclass
class RecordingCell:
    """Everything that an engine needs, in a run folder of its own."""

    folder: Path
    theatre: TheatreFile = field(default_factory=mini_theatre)
    operator: RecordingOperator = field(default_factory=RecordingOperator)
    strategy: Strategy = field(default_factory=lambda: find_strategy("ocs"))
    methods: CaseMethods = field(default_factory=CaseMethods)

    def __post_init__(self) -> None:
        self.folder.mkdir(exist_ok=True)
        head = self.calibrations.stereo_head
        self.arm = RecordingArm("arm")
        self.stereo = RecordingStereo("stereo", serials=(head.left.serial, head.right.serial))
        on_tools = (tool.frame.tool for tool in self.theatre.tools.values() if tool.frame is not None)
        frames = (self.calibrations.tracker_frame.tool, *on_tools)
        self.tracker = RecordingTracker("tracker", tools=frames)
        self.journal = Journal(self.folder)
        self.room = RecordingRoom(self.arm)
        self.case = Case(self.folder)
        self.series, self.plan = self.folder / "ct", self.folder / "plan.toml"
        self.opened = RecordingTheatre(self.theatre, self.arm, self.stereo, self.tracker)
        self.clock = self.opened.clock
        self.workcell = self.make_workcell()
        self.have_asked(RecordingOperator().word)  # until an engine asks

    def have_asked(self, ask: Callable[[Question], str]) -> None:
        """Have the workcell ask before its motions, without an engine."""
        resting = Checkpoint(ask, lambda _state, _reason: nullcontext(), self.clock)
        self.workcell.master.supervised.ask_before(resting, ask)

    @property
    def calibrations(self) -> Calibrations:
        assert self.theatre.calibration is not None
        return self.theatre.calibration

    def make_workcell(
        self, calibrations: Calibrations | None = None, history: ArmHistory | None = None
    ) -> Workcell:
        return Workcell(
            self.opened, self.journal, calibrations=calibrations, histories={MASTER: history or ArmHistory()}
        )

    def add_assistant(self, assistant: Any) -> None:
        """Have this stand in for the assistant of a case with two arms."""
        self.workcell.assistants = (assistant,)
        self.workcell.arms = {MASTER: self.workcell.master, ASSISTANT: assistant}

    def setting(self) -> CaseSetting:
        return CaseSetting(
            workcell=self.workcell,
            clock=self.clock,
            operator=self.operator,
            room=self.room,
            settings=ProcedureSettings(),
            surroundings=self.theatre.cell,
            clinical=ClinicalInput(self.series, self.plan, self.strategy, methods=self.methods),
        )

    def engine(self, order: CaseOrder) -> Engine:
        return Engine(order, self.case, self.setting(), self.journal)

    def entries(self, *kinds: str) -> list[tuple[str, str]]:
        """Kind and step of the journal's lines; of all kinds when none is named."""
        lines = read_journal(self.folder / JOURNAL_FILE)
        return [
            (str(line["entry"]), str(line.get("step", "")))
            for line in lines
            if not kinds or line["entry"] in kinds
        ]

    def motions(self, what: str) -> list[object]:
        """Trajectories of the journal's motions of that kind."""
        lines = read_journal(self.folder / JOURNAL_FILE)
        return [line["trajectory"] for line in lines if line.get("what") == what]


def tool_pose(joints_rad: Sequence[float], cell: RecordingCell) -> Transform:
    """ROBOT <- TOOL of the guide at joint angles."""
    a, b, c, d, e, f = joints_rad
    flange = cell.arm.kinematics.flange_pose((a, b, c, d, e, f))
    return cast(
        "Transform",
        flange @ cell.calibrations.tool_tip.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL),
    )
