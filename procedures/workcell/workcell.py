"""The workcell: an arm with its tool, surroundings, stereo head and tracker, for taking looks and moving.

A workcell needs an open journal, in which every motion is an intent and a result. While the guide is held
before an entry, only motion along its axis is possible, whoever asks. While an instrument is in the guide,
nothing moves at all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from procedures.journal.errors import JournalNotWritable
from procedures.journal.journal import Entry, Journal
from procedures.operator.question import Topic
from procedures.planning.tool_records import ToolRecords
from procedures.room.sighting import Sighting
from procedures.strategies.strategy import AXIAL_SPEED_FRACTION, Sides, approach_joints
from procedures.workcell.arm_history import (
    UNMOVED,
    ArmHistory,
    ArmLog,
    HeldInstrument,
    InsertionAxis,
    MotionKind,
    describe_instrument,
)
from procedures.workcell.arm_load import read_axis_loads
from procedures.workcell.arm_pair import ArmPair, Halt
from procedures.workcell.assistant import AT_GUIDE, Assistant
from procedures.workcell.device_views import DeviceView
from procedures.workcell.errors import GuideHeldAtEntry, InstrumentInGuide, OtherArmUnknown
from procedures.workcell.motions import PlannedMotion
from procedures.workcell.stereo_look import Look, Sensors, look
from procedures.workcell.supervised_arm import SupervisedArm
from procedures.workcell.tools import CarriedTool, Instrument, MountedTool, ToolMount
from procedures.workcell.tracker_move import UNPUSHED, TrackerMove
from ronna_hw.arm.clearance.bodies import ARMS_OWN_RADII, Surroundings
from ronna_hw.arm.pose import Pose
from ronna_hw.config import ASSISTANT, MASTER, Calibrations, DeviceConfig
from ronna_hw.devices import JointMove, LineMove, Motion, OpticalTracker, RobotArm, StereoPair
from ronna_hw.devices.axis_loads import LOAD_CYCLES, AxisLoads
from ronna_hw.devices.errors import WrongKind
from ronna_hw.devices.lifecycle import RUNNING, Device, Lifecycle
from ronna_hw.devices.readings import ArmReading
from ronna_hw.devices.robot import ConfirmedStart
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform
from ronna_hw.theatre import Theatre
from ronna_hw.theatre_kind import require_one_kind
from ronna_hw.vectors import JointVector

D = TypeVar("D")

ONE_LOOK_MM = 5.0  # by which a moved cart, seen by one look at the frame on its arm, may be misplaced (U)
TURNED_SHARE = 0.25  # of the way of its frame, by which a cart that turned has moved other parts differently
TURNED_CART = 2.0  # a cart that turned moves parts of its arm farther than the frame that shows it


class Workcell(SupervisedArm):
    """An arm with its tool and devices. All tool poses are ROBOT <- TOOL of the mounted tool."""

    def __init__(
        self,
        theatre: Theatre,
        journal: Journal,
        *,
        calibrations: Calibrations | None = None,
        calibrating: bool = False,
        history: ArmHistory = UNMOVED,
        assistant: ArmHistory | None = None,
        pair: type[ArmPair] = ArmPair,
    ) -> None:
        """Create the workcell without opening or moving anything.

        `calibrations` replace those of the theatre file. While `calibrating`, a tool's record may refer to a
        former tip. A resumed run has a `history`. With two arms, `assistant` is the history of the second,
        and a `pair` moves and watches both.
        Raises PRO-003 without an open journal, DEV-007 without a device or calibrations, ARM-009, CFG-004 and
        CAL-013.
        """
        if journal.closed:
            raise JournalNotWritable("the journal is closed: nothing may move without it")
        require_one_kind(theatre.file)
        roles = (MASTER,) if assistant is None else (MASTER, ASSISTANT)
        theatre.require("tracker", "stereo", *(f"robot.{role}" for role in roles))
        self.calibrations = theatre.calibrations if calibrations is None else calibrations
        self._theatre = theatre
        self._around_assistant: tuple[Surroundings, JointVector | None] | None = None  # robot frame
        self._make_pair = pair
        self.reading: Callable[[], AbstractContextManager[None]] = nullcontext  # see `ArmPair`
        self._pair: ArmPair | None = None
        self.assistant: Assistant | None = None
        drive: Callable[[Motion, PlannedMotion], ArmReading] | None = None
        if assistant is not None:
            drive = partial(self._drive_one, MASTER)
            self.assistant = Assistant(
                lambda: theatre.arms[ASSISTANT],
                ArmLog(journal, theatre.clock, assistant),
                self.calibrations,
                partial(self._drive_one, ASSISTANT),
                self._release_held,
                lambda: self.instrument.inside,
                partial(self._look_around, ASSISTANT),
            )
        super().__init__(
            "arm",
            ArmLog(journal, theatre.clock, history),
            lambda: theatre.arms[MASTER],
            self.calibrations.arm,
            drive,
            self._release_held,
            other=self.calibrations.assistant_arm,
            look_around=partial(self._look_around, MASTER),
        )
        self.mount = ToolMount(self.read_tool_number, self.calibrations)
        self.tools = ToolRecords.of(theatre.file, calibrating=calibrating)
        self.patient_frame = (
            theatre.file.procedure.patient_frame
        )  # the tracker's name for it, if there is one
        self.instrument = Instrument(self._log)
        self.surroundings: Surroundings | None = None  # as last declared to the arm
        # Callbacks of a display: quick, never raise.
        self.on_look: Callable[[Look], None] = lambda _look: None
        self.on_stop_failed: Callable[[str], object] = lambda _failure: None
        self.sensors = Sensors(lambda: self.stereo, self.calibrations.stereo_head)

    @property
    def stereo(self) -> StereoPair:
        """Stereo head; use `look` to take pictures."""
        return self._theatre.stereo

    @property
    def tracker(self) -> OpticalTracker:
        """Optical tracker."""
        return self._theatre.tracker

    @property
    def devices(self) -> Mapping[str, DeviceView]:
        """Devices by role, in connection order; additional devices as `device.NAME`."""
        assistant = {} if self.assistant is None else {ASSISTANT: self.assistant.arm}
        return {**self._devices, "arm": self.arm, **assistant}

    @property
    def _devices(self) -> dict[str, Device]:
        others = {f"device.{name}": self.device(name, Device) for name in self._theatre.file.device}
        arms: dict[str, Device] = {"arm": self._arm}
        if self.assistant is not None:
            arms[ASSISTANT] = self._theatre.arms[ASSISTANT]
        return {"tracker": self._theatre.tracker, **arms, "stereo": self.stereo, **others}

    @property
    def device_tables(self) -> Mapping[str, DeviceConfig]:
        """Tables of the devices in the theatre file: `tracker`, `robot.NAME`, `stereo`, `device.NAME`."""
        return self._theatre.file.devices

    def device(self, name: str, interface: Callable[..., D]) -> D:
        """Return the device from table `[device.NAME]` as `interface`.

        Raises DEV-007 without such a table, DEV-008 for a device of another kind and for an arm.
        """
        device = self._theatre.device(name, interface)
        if isinstance(device, RobotArm):
            raise WrongKind(
                f"device.{name} is an arm, which only the workcell moves",
                action="Declare it as [robot.NAME].",
            )
        return device

    # Mounted tool

    @property
    def tool(self) -> MountedTool:
        """Mounted tool, as found by the last check."""
        return self.mount.tool

    def read_tool_number(self) -> int:
        """Return the tool number now reported by the controller's inputs; 0 means no tool."""
        return self._arm.read_tool_identity().number

    def flange_from(self, tool: MountedTool) -> Transform:
        """Return FLANGE <- TOOL from a tool's calibration record. Raises PRO-009 for an unknown tool."""
        return self.mount.flange_from(tool)

    @property
    def flange_from_tool(self) -> Transform:
        """Transform FLANGE <- TOOL of the mounted tool."""
        return self.flange_from(self.tool)

    # Pose, load and place of the arm

    def read_load(self, cycles: int = LOAD_CYCLES) -> AxisLoads | None:
        """Average the controller's signals of the load since the arm rests; None if its driver has none.

        For an estimate see `arm_load.as_standstill`. Raises the arm's error if it does not rest.
        """
        return read_axis_loads(self._arm, cycles, since_rest=True)

    def tool_pose(self, joints_rad: JointVector | None = None, arrived: Sides = None) -> Transform:
        """Return the mounted tool's pose at joint angles, by default the measured ones; see `Sides`."""
        return self._carried.pose(joints_rad or self.joints_rad(), arrived)

    def joints_at(self, pose: Transform, near: JointVector, arriving: Sides = None) -> JointVector:
        """Return the joints for a tool pose, in the branch of `near`. Raises ARM-001 to ARM-003."""
        return self._carried.joints_at(pose, near, arriving)

    @property
    def _carried(self) -> CarriedTool:
        return CarriedTool(self.calibrated, self.flange_from_tool)

    @property
    def carries(self) -> str:
        """Name of the load, as questions name it."""
        return f"the {self.tool}"

    @property
    def supervised_arms(self) -> tuple[SupervisedArm, ...]:
        """Every arm of the workcell, this one first."""
        return (self,) if self.assistant is None else (self, self.assistant)

    @property
    def is_any_arm_out(self) -> bool:
        """Whether an arm may be away from its home."""
        return any(arm.place.is_out for arm in self.supervised_arms)

    def compare_places(self) -> None:
        """Compare where each arm is with the journal; see `compare_place`.

        An arm that reports no joints does not keep the other from being compared; its error is raised then.
        """
        silent: list[RonnaError] = []
        for arm in self.supervised_arms:
            try:
                arm.compare_place()
            except RonnaError as error:
                silent.append(error)
        if silent:
            raise silent[0]

    def tracker_move(self, localization: str) -> TrackerMove:
        """Return how the tracker was moved since this localization, as far as it was followed."""
        known = self._log.history.tracker
        return known[1] if known is not None and known[0] == localization else UNPUSHED

    def record_tracker_move(self, localization: str, move: TrackerMove) -> None:
        """Journal a followed move of the tracker. Raises PRO-003."""
        self._log.write(Entry.TRACKER, **move.as_plain(localization))

    def looks(self, localization: str) -> tuple[Sighting, ...]:
        """Return the looks at the room since this localization."""
        known = self._log.history.looks
        return known[1] if known is not None and known[0] == localization else ()

    def record_look(self, localization: str, look: Sighting) -> None:
        """Journal a look at the room; it reaches the disk before the next motion. Raises PRO-003."""
        self._log.note(Entry.LOOK, localization=localization, look=look.as_plain())

    def record_found_on_axis(self, axis: InsertionAxis) -> None:
        """Journal that the guide was found on an axis, in case the original line was lost."""
        joints_rad, plain = list(self.joints_rad()), axis.as_plain()
        self._log.note(
            Entry.PLACED, joints_rad=joints_rad, at_home=False, trajectory=axis.trajectory, axis=plain
        )

    # Motion

    def surround(self, surroundings: Surroundings, near_rad: JointVector | None = None) -> None:
        """Set the arm's tool and surroundings. Clearance is exact near `near_rad`, by default home."""
        near_rad = near_rad or self._log.home_rad or self.arm.kinematics.home_rad
        self.surroundings = self.calibrated.as_controller_sees(surroundings, near_rad)
        self._surround_master(self.surroundings)

    def _surround_master(self, surroundings: Surroundings) -> None:
        self._arm.surround(surroundings)
        if self._pair is not None:
            self._pair.surround(MASTER, surroundings)

    # Two arms

    def place_assistant(self, robot_from_base: Transform, uncertain_mm: float = 0.0) -> None:
        """Take the assistant's base as known: from now on either arm may move, watched with the other.

        `uncertain_mm` is by how much the arm may be elsewhere.
        """
        assistant = self._require_assistant()
        base = Pose.from_matrix(robot_from_base.as_matrix().tolist())
        assistant.place_base(robot_from_base, uncertain_mm)
        if self._pair is None:
            arms, clock = self._theatre.arms, self._theatre.clock
            self._pair = self._make_pair(arms, base, clock, lambda: self.instrument.inside)
            self._pair.reading = self.reading
            if self.surroundings is not None:
                self._surround_master(self.surroundings)
            known = self._for_assistant(self.surroundings or Surroundings())
            bare = replace(known, obstacles=(), corridor=None, zone=None, tool=assistant.tool())
            self._pair.surround(ASSISTANT, bare)  # until its own surroundings are declared
        self._pair.place_assistant(base, uncertain_mm)
        self._allow_contact()

    def surround_assistant(self, surroundings: Surroundings, near_rad: JointVector | None = None) -> None:
        """Set what surrounds the assistant, in the robot frame; its tool is its own.

        Clearance is exact near `near_rad`, by default home.
        """
        assistant = self._require_assistant()
        assert self._pair is not None, "where the assistant stands is known first"
        surroundings = self._for_assistant(surroundings)
        self._around_assistant = surroundings, near_rad
        self._pair.surround(ASSISTANT, assistant.surroundings(surroundings, near_rad))

    def _for_assistant(self, around: Surroundings) -> Surroundings:
        """Return surroundings for the assistant: measured radii hold for one of the same model."""
        same = self._require_assistant().arm.kinematics.name == self._arm.kinematics.name
        return around if same else replace(around, radii=ARMS_OWN_RADII)

    @property
    def instrument_description(self) -> str | None:
        """Statement that an instrument is or may be inside or in the assistant's holder; None if not."""
        held = None if self.assistant is None else self.assistant.history.held
        return describe_instrument(self.place, held)

    def hold_instrument(self, held: HeldInstrument) -> None:
        """Take an instrument as held by the assistant, which may come close to the guide from now on."""
        self._require_assistant().hold_instrument(held)
        self._take_into_account()

    def release_instrument(self) -> None:
        """Take the assistant's holder as empty, once that is confirmed; it keeps its distance again."""
        if self.assistant is not None and self.assistant.history.held is not None:
            self.assistant.release_instrument()
            self._take_into_account()

    def _take_into_account(self) -> None:
        self._allow_contact()
        if self._around_assistant is not None:
            self.surround_assistant(*self._around_assistant)

    def _allow_contact(self) -> None:
        """Let the instrument in the holder come close to the guide, and nothing without one."""
        held = self._require_assistant().history.held
        if self._pair is not None:
            self._pair.allow_contact(*((), ()) if held is None else (held.at_bore, AT_GUIDE))

    def assistant_rests_clear(self, joints_rad: JointVector, tip_mm: float) -> bool:
        """Return whether the assistant, with such an instrument, keeps its margin at these joints."""
        assert self._around_assistant is not None, "what surrounds the assistant is known first"
        return self._require_assistant().rests_clear(joints_rad, self._around_assistant[0], tip_mm)

    def rest_apart(self, role: str, joints_rad: JointVector) -> bool:
        """Return whether an arm, at these joints, would keep its distance from the other where that rests."""
        assert self._pair is not None, "where the assistant stands is known first"
        here_rad = {MASTER: self.joints_rad(), ASSISTANT: self._require_assistant().joints_rad()}
        return self._pair.rest_apart(here_rad | {role: joints_rad})

    @property
    def halt(self) -> Halt | None:
        """Why both arms are halted, if they are."""
        return None if self._pair is None else self._pair.halted

    def release_halt(self, by: str) -> None:
        """Release a halt of both arms once a named person has acknowledged their faults. Raises DUAL-001."""
        if self._pair is not None and self._pair.halted is not None:
            self._pair.acknowledge(by)

    def _require_assistant(self) -> Assistant:
        if self.assistant is None:
            raise OtherArmUnknown("there is no assistant in this case", action="Start the run with --dual.")
        return self.assistant

    @property
    def insertion_limit_N(self) -> float | None:
        """Force on the instrument that stops its insertion by the assistant; None if that senses none."""
        senses = self.assistant is not None and self.assistant.senses_force
        return self._theatre.file.procedure.insertion_force_N if senses else None

    def _drive_one(self, role: str, leg: Motion, motion: PlannedMotion) -> ArmReading:
        if self._pair is None:
            raise OtherArmUnknown(
                "where the assistant stands is not known", action="Run base_to_base first: nothing has moved."
            )
        if role == ASSISTANT and motion.axis is not None:
            assistant, limit_N = self._require_assistant(), self.insertion_limit_N
            if assistant.has_passed(leg, motion):
                return self._theatre.arms[ASSISTANT].read_state()
            if limit_N is not None and (insertion := assistant.force_limited(leg, motion, limit_N)):
                inserted = self._pair.insert(role, insertion)
                assistant.note_inserted(inserted)
                return inserted.reading
            return self._pair.move(role, leg, with_instrument=True)
        return self._pair.move(role, leg)

    def _look_around(self, role: str) -> None:
        if self._pair is not None:
            self._pair.look_around(role)

    def _release_held(self, by: str) -> bool:
        """Release a halt in which both arms are only held, as after a stop by the operator."""
        running = all(arm.state in RUNNING for arm in self._theatre.arms.values())
        if self._pair is None or not running:
            return False
        self._pair.acknowledge(by)
        return True

    def shift_room(self, by: Transform, on_cart: Collection[str]) -> None:
        """Move the room, with the assistant in it, against a moved cart of the master.

        The bodies that this cart carries, by name, stay. What surrounds the assistant stands to it as before.
        A later program has the former places, and is told how far the assistant may be from its own.
        """
        if (around := self.surroundings) is not None:
            moved = around.moved(Pose.from_matrix(by.as_matrix().tolist()))
            pairs = zip(around.obstacles, moved.obstacles, strict=True)
            obstacles = tuple(stays if stays.name in on_cart else moves for stays, moves in pairs)
            self.surroundings = replace(moved, obstacles=obstacles)
            self._surround_master(self.surroundings)
        if self._pair is not None:
            assistant = self._require_assistant()
            before, after = assistant.base, by @ assistant.base
            uncertain_mm = assistant.history.base_uncertain_mm
            by_mm = math.dist(before.translation_mm, after.translation_mm)
            assistant.place_base(before, uncertain_mm + by_mm)
            self._pair.place_assistant(
                Pose.from_matrix(after.as_matrix().tolist()), uncertain_mm + ONE_LOOK_MM
            )

    def doubt_assistant(self, seen_apart_mm: float) -> None:
        """Keep more distance between both arms: the assistant was seen elsewhere than its base has it."""
        if self._pair is None:
            return
        assistant = self._require_assistant()
        uncertain_mm = assistant.history.base_uncertain_mm + TURNED_CART * seen_apart_mm
        self.place_assistant(assistant.base, uncertain_mm)

    def follow_assistant(self, way_mm: ArrayLike) -> None:
        """Take the assistant for as far away (3,) mm, robot frame, as its frame was seen from its place.

        For the way home only: its cart may have turned as well.
        """
        assistant, way = self._require_assistant(), np.asarray(way_mm, dtype=float)
        moved_mm = float(np.linalg.norm(way))
        uncertain_mm = assistant.history.base_uncertain_mm + ONE_LOOK_MM + TURNED_SHARE * moved_mm
        self.place_assistant(assistant.base.displace(way), uncertain_mm)
        if self._around_assistant is not None:
            self.surround_assistant(*self._around_assistant)

    def start(self, *, cameras: bool = False) -> None:
        """Start the correction stream and, if requested, the cameras. Raises PRO-002, TOOL-001."""
        arms = (self._arm,) if self.assistant is None else (self._arm, self._theatre.arms[ASSISTANT])
        starting = any(arm.state is Lifecycle.CONFIGURED for arm in arms)
        if starting and not self._starts_still(arms):
            self.instrument.require_out("start the arm")
        self.supervised.start((*arms, self.stereo) if cameras else arms)

    def _starts_still(self, arms: Sequence[RobotArm]) -> bool:
        """Whether an assistant on the axis waits for both arms, and starting them moves nothing.

        Starting an unverified controller moves every axis. The assistant can only lead its instrument out
        once both arms are started.
        """
        if self.assistant is None or not self.assistant.place.is_on_axis:
            return False
        return not any(isinstance(arm, ConfirmedStart) and arm.to_confirm is not None for arm in arms)

    def go_motion(self, joints_rad: JointVector) -> PlannedMotion:
        """Return the motion that `go` would make."""
        return self._via_home(self.joint_motion(MotionKind.GO, JointMove(joints_rad)))

    def settle_motion(
        self, joints_rad: JointVector, arriving: Sides, *, allow_detour: bool = False
    ) -> PlannedMotion:
        """Return the motion that `settle` would make."""
        onto = JointMove(joints_rad)
        if arriving is None:
            return self.joint_motion(MotionKind.STEP, onto)
        back = JointMove(approach_joints(joints_rad, arriving))
        onto_from_side = self.joint_motion(MotionKind.SETTLE, back, onto)
        return self._via_home(onto_from_side) if allow_detour else onto_from_side

    def line_to_motion(
        self, pose: Transform, arriving: Sides = None, near_rad: JointVector | None = None
    ) -> PlannedMotion:
        """Return the motion that `line_to` would make, in the branch of `near_rad` (default: current)."""
        commanded = self._commanded_pose(pose, arriving, near_rad)
        return self._line_motion(MotionKind.LINE, pose, LineMove(commanded @ self.flange_from_tool.inverse()))

    def insert_motion(self, insertion: InsertionAxis, near_rad: JointVector | None = None) -> PlannedMotion:
        """Return the motion that `insert` would make; `near_rad` as for `line_to_motion`."""
        commanded = self._commanded_pose(insertion.held, insertion.arriving, near_rad)
        line = LineMove(commanded, self.flange_from_tool, AXIAL_SPEED_FRACTION)
        return self._line_motion(MotionKind.INSERT, insertion.held, line, insertion)

    def withdraw_motion(self, insertion: InsertionAxis) -> PlannedMotion:
        """Return the motion that `withdraw` would make."""
        line = LineMove(self._commanded_pose(insertion.start, insertion.arriving), self.flange_from_tool)
        return self._line_motion(MotionKind.WITHDRAW, insertion.start, line, insertion)

    def go(self, joints_rad: JointVector) -> ArmReading:
        """Move to joint angles, via home if the direct path is not clear. Raises ARM-007 if neither is."""
        return self.supervised.carry_out_with_detour(self.go_motion(joints_rad))

    def park(self, subject: str = "park the arm") -> ArmReading:
        """Return home once the operator has confirmed it. Raises PRO-002."""
        self.start()
        self.supervised.confirm(Topic.PARK, subject, [self.return_motion()])
        return self.return_home()

    def settle(self, joints_rad: JointVector, arriving: Sides, *, allow_detour: bool = False) -> ArmReading:
        """Move to joint angles, each joint arriving from its given side (+1 or -1) for equal backlash.

        Without directions, go straight there. `allow_detour` allows the way via home if the direct one is not
        clear.
        """
        settle_motion = self.settle_motion(joints_rad, arriving, allow_detour=allow_detour)
        return self.supervised.carry_out_with_detour(settle_motion)

    def line_to(self, pose: Transform, arriving: Sides = None) -> ArmReading:
        """Move the mounted tool to a pose along a straight line of the flange."""
        return self.supervised.carry_out(self.line_to_motion(pose, arriving))

    def insert(self, insertion: InsertionAxis) -> ArmReading:
        """Move the guide along its axis from the start of the approach to its held pose.

        Raises PRO-009 unless the guide is mounted, PRO-015 unless it is on the axis.
        """
        self._require_outside(MotionKind.INSERT)
        self.mount.check(MountedTool.GUIDE)
        return self.supervised.carry_out(self.insert_motion(insertion))

    def hold(self) -> None:
        """Hold still, supervised by the link, until the next motion."""
        if self._arm.state is Lifecycle.ACTIVE:
            self._arm.stop()
            self.supervised.note_hold()

    def withdraw(self, trajectory: str) -> ArmReading:
        """Move the guide back along its axis to the start of the approach.

        Raises PRO-014 if it is not on that trajectory, PRO-015 if it is beside its axis, TOOL-001 while an
        instrument is in it.
        """
        return self.supervised.carry_out(self.withdraw_motion(self._axis_of(trajectory)))

    def retreat(self, trajectory: str) -> None:
        """Withdraw the guide once the operator has confirmed it. Raises PRO-002 and as `withdraw`."""
        self.start()
        way_out = [self.withdraw_motion(self._axis_of(trajectory))]
        self.supervised.confirm(Topic.RETREAT, f"retreat from {trajectory}", way_out, trajectory)
        self.withdraw(trajectory)

    def _axis_of(self, trajectory: str) -> InsertionAxis:
        axis = self.place.axis
        if axis is None or axis.trajectory != trajectory:
            on = self.place.trajectory or "no trajectory"
            raise GuideHeldAtEntry(f"the guide is not on {trajectory}", expected=trajectory, got=on)
        return axis

    def recover(self, role: str, by: str) -> None:
        """Recover a faulted device without motion. After an arm fault, the tool must be checked again."""
        device = self._devices[role]
        device.recover(by)
        for arm in self.supervised_arms:
            if arm.drives(device):
                arm.expect_jogging()
        if device is self._arm and not self.place.is_on_axis:  # only the guide can be on an axis
            self.mount.tool = MountedTool.UNKNOWN

    def look(self) -> Look:
        """Take a stereo pair and measure the sphere in it. Raises STE-012 without a fresh, complete pair."""
        seen = look(self.stereo, self.calibrations.stereo_head, self._theatre.clock)
        self.on_look(seen)
        return seen

    def rest(self) -> None:
        """Stop the arm's correction stream and the cameras, for a tool change or a parked arm."""
        assistant = () if self.assistant is None else (self._theatre.arms[ASSISTANT],)
        for device in (self._arm, *assistant, self.stereo):
            if device.state in RUNNING:
                device.deactivate()
        self._reset_confirmations()

    def stop(self) -> None:
        """Stop every arm as far as its link permits; of two, a fault of one holds both. Never raises."""
        if self._pair is not None:
            self._pair.halt_for_fault()
        for failure in self._theatre.stop():
            self.on_stop_failed(failure)
        self._reset_confirmations()

    def _reset_confirmations(self) -> None:
        for arm in self.supervised_arms:
            arm.supervised.reset_confirmation()

    def close(self) -> None:
        """Close all connections, the arm's first. Never raises."""
        self._theatre.close()

    def _require_allowed(self, motion: PlannedMotion) -> None:
        """Raise if a motion would leave the guide's axis, or if the guide has been pushed off it."""
        on, axis = self.place.axis, motion.axis
        if axis is None or (on is not None and axis.trajectory != on.trajectory):
            self._require_outside(motion.what)
        else:
            self.instrument.require_out(motion.what)
            self._require_assistant_off_axis(motion.what)
            for pose in (self.tool_pose(), axis.held):
                (on or axis).check_on_axis(pose)

    def _via_home(self, direct: PlannedMotion) -> PlannedMotion:
        """Return a motion that may lead via home if its direct path is not clear."""
        if self._log.home_rad is None:
            return direct
        return replace(direct, replacement=(self.home_motion(), direct))

    def _line_motion(
        self, what: MotionKind, pose: Transform, line: LineMove, axis: InsertionAxis | None = None
    ) -> PlannedMotion:
        return PlannedMotion(what, self.carries, tuple(pose.translation_mm.tolist()), (line,), axis=axis)

    def _commanded_pose(
        self, pose: Transform, arriving: Sides, near_rad: JointVector | None = None
    ) -> Transform:
        return self._carried.commanded(pose, lambda: near_rad or self.joints_rad(), arriving)

    def _require_outside(self, what: str) -> None:
        self.instrument.require_out(what)
        self._require_assistant_off_axis(what)
        for held in self.place.hold_reasons:
            raise GuideHeldAtEntry(f"{what}: {held}", expected=f"a retreat along {self.place.trajectory}")

    def _require_assistant_off_axis(self, what: str) -> None:
        if self.assistant is not None and self.assistant.place.is_on_axis:
            raise InstrumentInGuide(f"{what}: the assistant is on the axis of the guide")
