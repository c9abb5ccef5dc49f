"""The controller: drives, operating mode, messages, and the one program it runs.

It owns no socket and no clock. `RsiRun` is the program while it streams; `Manipulator` is the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from ronna_hw.wire.kuka_context import RsiContext, context_hash
from ronna_hw.wire.kuka_eki import AckCode, OperationMode, ProState, RsiState
from sim.kuka.angles import pose_of_frame
from sim.kuka.manipulator import Manipulator
from sim.kuka.messages import Message
from sim.kuka.parameters import ControllerParameters
from sim.kuka.reply import Reply
from sim.kuka.rsi_run import RsiRun, RunSettings, StartPose
from sim.kuka.signal_flow import inputs_of


class Answer(NamedTuple):
    """What a request is answered with."""

    code: AckCode = AckCode.OK
    text: str = ""


DONE = Answer()
IDLE_PROGRAM_STATES = (ProState.FREE, ProState.RESET, ProState.END)
FULL_OVERRIDE = 100


class Controller:
    """A KR C4 with one arm, one RSI context, and a program that the EKI channels start and stop."""

    def __init__(
        self,
        context: RsiContext,
        arm: Manipulator,
        mounted_tool: Callable[[], int],
        parameters: ControllerParameters | None = None,
    ) -> None:
        self.context = context
        self.context_hash = context_hash(context)
        self.arm = arm
        self.mounted_tool = mounted_tool
        self.mode = OperationMode.EXT
        self.drives_on = False
        self.emergency_stop = False
        self.guard_open = False
        self.override_percent = FULL_OVERRIDE
        self.base_number = 0
        self.program_state = ProState.FREE
        self.cycle_ms: int = context.program.cycle_ms
        self.relative = context.program.corrections == "relative"
        self.message: Message | None = None
        self.run: RsiRun | None = None
        self.runs = 0
        self._parameters = parameters or ControllerParameters()
        inputs = inputs_of(context)
        self._wired = {"AXIS": inputs.axes is not None, "POS": inputs.frame is not None}
        feeds = {wire.indx for wire in context.wiring if wire.object in ("AXISCORR", "POSCORR")}
        self.holds_corrections = all(e.holdon for e in context.receive if e.indx in feeds)

    # -- what it is doing

    @property
    def rsi_state(self) -> RsiState:
        """State of the RSI program."""
        if self.message is not None:
            return RsiState.FAULT
        return self.run.state if self.run is not None else RsiState.IDLE

    @property
    def moving(self) -> bool:
        """True until the arm rests."""
        return not self.arm.drives.at_rest

    @property
    def may_move(self) -> bool:
        """True when a program could move the arm now."""
        return self.drives_on and not self.emergency_stop and not self.guard_open and self.message is None

    # -- the program

    def start(
        self,
        cycle_ms: int | None = None,
        relative: bool | None = None,
        correction: str | None = None,
        *,
        counts_from_first_reply: bool = False,
    ) -> Answer:
        """RSI_ON with the context's settings, or with others."""
        if self.run is not None:
            return Answer(AckCode.BUSY, "RSI is running")
        if self.mode is not OperationMode.EXT:
            return Answer(AckCode.REFUSED, f"mode {self.mode}")
        if self.message is not None:
            return Answer(AckCode.REFUSED, f"message {self.message.number} not acknowledged")
        if not self.may_move:
            return Answer(AckCode.NOT_READY, "drives off, emergency stop or guard")
        if self.program_state not in IDLE_PROGRAM_STATES:
            return Answer(AckCode.REFUSED, f"program is {self.program_state}")
        if correction is not None and not self._wired.get(correction, False):
            return Answer(AckCode.BAD_VALUE, f"the context corrects no {correction}")
        if self.moving:
            return Answer(AckCode.BUSY, "arm is moving")
        self.cycle_ms = cycle_ms or self.cycle_ms
        self.relative = self.relative if relative is None else relative
        self.runs += 1
        self.arm.drives.start_cycles(self.cycle_ms / 1000.0)
        settings = RunSettings(self.context, self.cycle_ms, self.relative, self.runs, counts_from_first_reply)
        pose = StartPose(self.arm.axes_deg, self.arm.frame, self.arm.tool_point(), self.arm.base)
        self.run = RsiRun(settings, self.arm.description, pose, self.arm.joints_for, self._parameters)
        self.program_state = ProState.ACTIVE
        return DONE

    def cancel(self) -> Answer:
        """End RSI and deselect the program; the arm comes to rest on its own."""
        if self.message is not None:
            return Answer(AckCode.REFUSED, f"message {self.message.number} not acknowledged")
        self._end_run(ProState.FREE)
        return DONE

    def select(self) -> Answer:
        """Select the program without starting it."""
        if self.run is not None or self.message is not None:
            return Answer(AckCode.REFUSED, f"program is {self.program_state}")
        self.program_state = ProState.RESET
        return DONE

    def stop(self) -> Answer:
        """Stop the program without cancelling it: the arm brakes, RSI may go on streaming."""
        self._interrupt()
        return DONE

    def acknowledge(self) -> Answer:
        """Acknowledge the message and reset the program."""
        if self.emergency_stop or self.guard_open:
            return Answer(AckCode.NOT_READY, "emergency stop or guard")
        self.message = None
        self._end_run(ProState.FREE)
        return DONE

    # -- drives and safety

    def switch_drives(self, on: bool) -> Answer:
        """Drives on or off; off stops the arm."""
        if on and (self.emergency_stop or self.guard_open):
            return Answer(AckCode.NOT_READY, "emergency stop or guard")
        if not on:
            self._interrupt()
        self.drives_on = on
        return DONE

    def press_emergency_stop(self, pressed: bool) -> None:
        """The button on the pendant."""
        self.emergency_stop = pressed
        if pressed:
            self._interrupt()
            self.drives_on = False

    def open_guard(self, is_open: bool) -> None:
        """The safety gate; in the automatic modes it stops the arm."""
        self.guard_open = is_open
        if is_open:
            self._interrupt()

    def turn_key(self, mode: OperationMode) -> None:
        """The key switch; a change stops a running program."""
        if mode is not self.mode:
            self._interrupt()
        self.mode = mode

    # -- tool, base, override

    def set_override(self, percent: int) -> Answer:
        """Program override. Sensor corrections are not scaled by it."""
        if not 1 <= percent <= FULL_OVERRIDE:
            return Answer(AckCode.BAD_VALUE, "override is 1 to 100")
        self.override_percent = percent
        return DONE

    def set_tool(self, frame: Sequence[float]) -> Answer:
        """Use another $TOOL: X Y Z (mm) A B C (deg) in the flange frame."""
        if self.run is not None:
            return Answer(AckCode.REFUSED, "RSI is running")
        self.arm.set_tool(pose_of_frame(frame))
        return DONE

    def set_base(self, number: int, frame: Sequence[float]) -> Answer:
        """Use another $BASE: X Y Z (mm) A B C (deg) in $ROBROOT."""
        if self.run is not None:
            return Answer(AckCode.REFUSED, "RSI is running")
        self.arm.set_base(pose_of_frame(frame))
        self.base_number = number
        return DONE

    # -- the cycle

    def finish_cycle(self, reply: Reply | None) -> None:
        """End a cycle of the running program: take the reply, move the arm, publish."""
        run = self.run
        if run is None:
            return
        run.finish(reply)
        if run.over:
            if run.message is not None:
                self._fail(run.message)
            else:
                self._end_run(ProState.END)
            self.arm.settle()
        elif run.held:
            if self.program_state is ProState.ACTIVE:
                self._interrupt()
            self.arm.settle()
        else:
            self.arm.follow(run.command_deg, heard=reply is not None)

    def settle(self) -> None:
        """One cycle without a program."""
        self.arm.settle()

    def _fail(self, message: Message) -> None:
        self.message = message
        self.arm.drives.brake()
        if message.drives_off:
            self.drives_on = False
        self._end_run(ProState.STOP)

    def _interrupt(self) -> None:
        self.arm.drives.brake()
        if self.run is None:
            return
        if self._parameters.streams_after_stop:
            self.run.hold()
            self.program_state = ProState.STOP
        else:
            self._end_run(ProState.STOP)

    def _end_run(self, state: ProState) -> None:
        self.run = None
        self.program_state = state
