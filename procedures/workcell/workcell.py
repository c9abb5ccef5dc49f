"""The workcell: arms by role, stereo head and tracker, the looks taken with them and what is known of those.

It needs an open journal, in which every motion is an intent and a result. The first arm is the master, which
carries the guide; each further one has its own class. What moves an arm is that arm's own.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple, TypeVar

from procedures.journal.errors import JournalNotWritable
from procedures.journal.journal import Entry, Journal, Line
from procedures.planning.tool_records import ToolRecords
from procedures.room.sighting import Sighting
from procedures.workcell.arm_history import ArmHistory, ArmLog, HeldInstrument, describe_instrument
from procedures.workcell.arms import Arms, Halt
from procedures.workcell.assistant import Assistant
from procedures.workcell.device_views import DeviceView
from procedures.workcell.errors import OtherArmUnknown
from procedures.workcell.line_look import LineLook, look_at_line
from procedures.workcell.master import Master
from procedures.workcell.stereo_look import Look, Sensors, look
from procedures.workcell.supervised_arm import SupervisedArm
from procedures.workcell.tracker_move import UNPUSHED, TrackerMove
from ronna_hw.config import Calibrations, DeviceConfig
from ronna_hw.devices import OpticalTracker, RobotArm, StereoPair
from ronna_hw.devices.errors import WRONG_KIND
from ronna_hw.devices.lifecycle import RUNNING, Device, Lifecycle
from ronna_hw.devices.robot import ConfirmedStart
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform
from ronna_hw.roles import MASTER
from ronna_hw.theatre import Theatre
from ronna_hw.theatre_kind import require_one_kind

D = TypeVar("D")

ONE_ARM: Mapping[str, ArmHistory] = MappingProxyType({MASTER: ArmHistory()})


class ArmsPhrases(NamedTuple):
    """Words for all arms of a case: their name, a statement about them, their ways and their homing."""

    arms: str
    are: str
    ways: str
    going_home: str


THE_ARM = ArmsPhrases("the arm", "the arm is", "the arm's way", "the arm goes home")
BOTH_ARMS = ArmsPhrases("both arms", "both arms are", "the arms' ways", "both arms go home")


class Workcell:
    """The devices of a case: `arms` by role, the master first, with their tools and histories."""

    def __init__(
        self,
        theatre: Theatre,
        journal: Journal,
        *,
        calibrations: Calibrations | None = None,
        calibrating: bool = False,
        histories: Mapping[str, ArmHistory] = ONE_ARM,
        make_arms: Callable[..., Arms] = Arms,
        enhance_contrast: bool = False,
    ) -> None:
        """Create the workcell without opening or moving anything.

        `calibrations` replace those of the theatre file. While `calibrating`, a tool's record may refer to a
        former tip. `histories` name the arms by role, the master first; a resumed run knows more of them.
        `make_arms` makes what moves them, as the constructor of `Arms`. `enhance_contrast` is for every look.
        Raises PRO-003 without an open journal, DEV-007 without a device or calibrations, ARM-009, CFG-004 and
        CAL-013.
        """
        if journal.closed:
            raise JournalNotWritable("the journal is closed: nothing may move without it")
        require_one_kind(theatre.file)
        theatre.require("tracker", "stereo", *(f"robot.{role}" for role in histories))
        self.calibrations = theatre.calibrations if calibrations is None else calibrations
        self.tools = ToolRecords.of(theatre.file, calibrating=calibrating)
        self.patient_frame = theatre.file.procedure.patient_frame  # the tracker's name for it, if any
        self._theatre, self.clock = theatre, theatre.clock
        logs = {role: ArmLog(journal, theatre.clock, history) for role, history in histories.items()}
        self._log = logs[MASTER]
        self.motion = make_arms(
            theatre.arms, tuple(histories), theatre.clock, lambda: self.master.instrument.inside
        )
        force_N = theatre.file.procedure.insertion_force_N
        self.assistants = tuple(
            Assistant(role, log, self.motion, self.calibrations, force_N)
            for role, log in logs.items()
            if role != MASTER
        )
        self.master: Master = Master(self._log, self.motion, self.calibrations, self.assistants)
        self.arms: Mapping[str, SupervisedArm] = {arm.role: arm for arm in (self.master, *self.assistants)}
        # Callbacks of a display: quick, never raise.
        self.on_look: Callable[[Look | LineLook], None] = lambda _look: None
        self.on_stop_failed: Callable[[str], object] = lambda _failure: None
        self._enhance_contrast = enhance_contrast
        self.sensors = Sensors(lambda: self.stereo, self.calibrations.stereo_head)

    @property
    def stereo(self) -> StereoPair:
        """Stereo head; use `look` to take pictures."""
        return self._theatre.stereo

    @property
    def tracker(self) -> OpticalTracker:
        return self._theatre.tracker

    @property
    def devices(self) -> Mapping[str, DeviceView]:
        """Devices by role, in connection order; additional devices as `device.NAME`."""
        return {**self._devices, **{arm.name: arm.arm for arm in self.arms.values()}}

    @property
    def _devices(self) -> dict[str, Device]:
        others = {f"device.{name}": self.device(name, Device) for name in self._theatre.file.device}
        arms: dict[str, Device] = {arm.name: self.motion[role] for role, arm in self.arms.items()}
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
            raise WRONG_KIND(
                f"device.{name} is an arm, which only the workcell moves",
                action="Declare it as [robot.NAME].",
            )
        return device

    @property
    def assistant(self) -> Assistant:
        """The arm that inserts the instrument. Raises DUAL-003 in a case without one."""
        for arm in self.assistants:
            return arm
        raise OtherArmUnknown("there is no assistant in this case", action="Start the run with --dual.")

    @property
    def phrases(self) -> ArmsPhrases:
        """Words for all arms in sentences about what they do together."""
        return BOTH_ARMS if self.assistants else THE_ARM

    @property
    def outermost_first(self) -> tuple[SupervisedArm, ...]:
        """The arms in the order of a way out: whatever reaches into the guide leaves before the guide."""
        return (*self.assistants, self.master)

    def arm_of_device(self, device: str) -> SupervisedArm | None:
        """Return the arm that is the device of this name, or None for another device."""
        return next((arm for arm in self.arms.values() if arm.name == device), None)

    @property
    def is_any_arm_out(self) -> bool:
        """Whether an arm may be away from its home."""
        return any(arm.place.is_out for arm in self.arms.values())

    def compare_places(self) -> None:
        """Compare where each arm is with the journal; see `compare_place`.

        An arm that reports no joints does not keep the others from being compared; its error is raised then.
        """
        silent: list[RonnaError] = []
        for arm in self.arms.values():
            try:
                arm.compare_place()
            except RonnaError as error:
                silent.append(error)
        if silent:
            raise silent[0]

    @property
    def instrument_description(self) -> str | None:
        """Statement that an instrument is or may be inside or in a holder; None if not."""
        return describe_instrument(self.master.place, self.held_instrument)

    @property
    def held_instrument(self) -> HeldInstrument | None:
        """Instrument in the holder of an arm, by the journal."""
        held = (arm.history.held for arm in self.arms.values())
        return next((one for one in held if one is not None), None)

    def record_drill_at_rest(self) -> None:
        """Take the drill in a holder as switched off."""
        for arm in self.assistants:
            arm.record_drill(may_turn=False)

    def release_instrument(self) -> None:
        """Take every holder as empty, once that is confirmed."""
        for arm in self.assistants:
            arm.release_instrument()

    def shift_room(self, by: Transform, on_cart: Collection[str]) -> None:
        """Move the room, with the other arms in it, against a moved cart of the master.

        The bodies that this cart carries, by name, stay.
        """
        for arm in self.arms.values():
            arm.shift_room(by, on_cart)

    @property
    def halt(self) -> Halt | None:
        """Why all arms are halted, if they are."""
        return self.motion.halted

    def release_halt(self, by: str) -> None:
        """Release a halt once a named person has acknowledged the faults. Raises DUAL-001."""
        if self.motion.halted is not None:
            self.motion.acknowledge(by)

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

    def scanned_looks(self, paths: str) -> tuple[Line, ...]:
        """Return the looks at the skin that were kept of an interrupted scan.

        It was by this path check, or by first looks at this measured head.
        """
        known = self._log.history.scanned
        return known[1] if known is not None and known[0] == paths else ()

    def record_scanned_look(self, paths: str, look: Line | None) -> None:
        """Journal a look at the skin; it is on disk on return. None: the scan is whole. Raises PRO-003."""
        self._log.write(Entry.SCANNED, paths=paths, look=look)

    def look(self) -> Look:
        """Take a stereo pair and measure the sphere in it. Raises STE-012 without a fresh, complete pair."""
        head, enhance_contrast = self.calibrations.stereo_head, self._enhance_contrast
        seen = look(self.stereo, head, self.clock, enhance_contrast=enhance_contrast)
        self.on_look(seen)
        return seen

    def look_at_line(self) -> LineLook:
        """Measure the projector's line, lit for this look alone. Raises SRF-030, STE-012."""
        seen = look_at_line(self.stereo, self.calibrations.stereo_head, self.clock)
        self.on_look(seen)
        return seen

    def start(self, *, cameras: bool = False) -> None:
        """Start the correction streams and, if requested, the cameras. Raises PRO-002, TOOL-001."""
        arms = tuple(arm for _, arm in self.motion.items())
        starting = any(arm.state is Lifecycle.CONFIGURED for arm in arms)
        if starting and not self._starts_still(arms):
            self.master.instrument.require_out("start the arm")
        for one in self.arms.values():
            one.start()
        if cameras and self.stereo.state is Lifecycle.CONFIGURED:
            self.stereo.activate()

    def _starts_still(self, arms: Sequence[RobotArm]) -> bool:
        """Whether an assistant on the axis waits for all arms, and starting them moves nothing.

        Starting an unverified controller moves every axis. An instrument can only be led out once all arms
        are started.
        """
        if not any(arm.leads_instrument for arm in self.arms.values()):
            return False
        return not any(isinstance(arm, ConfirmedStart) and arm.to_confirm is not None for arm in arms)

    def recover(self, role: str, by: str) -> None:
        """Recover a faulted device without motion. After an arm fault, the tool must be checked again."""
        self._devices[role].recover(by)
        if (arm := self.arm_of_device(role)) is not None:
            arm.expect_jogging()
            arm.doubt_tool()

    def rest(self) -> None:
        """Stop the arms' correction streams and the cameras, for a tool change or a parked arm."""
        for device in (*(arm for _, arm in self.motion.items()), self.stereo):
            if device.state in RUNNING:
                device.deactivate()
        self._reset_confirmations()

    def stop(self) -> None:
        """Stop every arm as far as its link permits; a fault of one halts all. Never raises."""
        self.motion.halt_for_fault()
        for failure in self._theatre.stop():
            self.on_stop_failed(failure)
        self._reset_confirmations()

    def _reset_confirmations(self) -> None:
        for arm in self.arms.values():
            arm.supervised.reset_confirmation()

    def close(self) -> None:
        """Close all connections, the arms' first. Never raises."""
        self._theatre.close()
