"""Simulated KR C4 controller: drives, operating mode, message and the running program.

It owns neither socket nor clock. `RsiRun` is the program while it streams, `EkiMotion` one motion of the EKI
program, `Manipulator` the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import dist

from ronna_hw.wire.kuka_context import RsiContext, context_hash
from ronna_hw.wire.kuka_eki import AckCode, OperationMode, ProState, RsiState
from sim.kuka.controller_parameters import IPO_FAST_S, ControllerParameters
from sim.kuka.manipulator import Manipulator
from sim.kuka.motion import DONE, Acknowledgement, EkiMotion
from sim.kuka.pendant import TRIPS, Interlocks, PendantMessage
from sim.kuka.rsi.program_run import RsiRun, RunSettings
from sim.kuka.rsi.signal_flow import resolve_inputs
from sim.kuka.rsi.telegrams import Reply

IDLE_PROGRAM_STATES = (ProState.FREE, ProState.RESET, ProState.END)
FULL_OVERRIDE = 100
ALL_BRAKES = 0b111111


class Controller:
    """A KR C4 with one arm, one RSI context and a program that the EKI channels start and stop."""

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
        self.interlocks = Interlocks()
        self.drives_on = False
        self.override_percent = FULL_OVERRIDE
        self.program_state = ProState.FREE
        self.cycle_ms: int = context.program.cycle_ms
        self.relative = context.program.corrections == "relative"
        self.message: PendantMessage | None = None
        self.run: RsiRun | None = None
        self.motion: EkiMotion | None = None
        self.runs = 0
        self.parameters = parameters or ControllerParameters()
        self.is_sensor_dead = False  # the force sensor's, if there is one
        self._overloaded = False
        self._fast_cycles = 0
        inputs = resolve_inputs(context)
        self._wired = {"AXIS": inputs.axes is not None, "POS": inputs.frame is not None}
        feeds = {wire.indx for wire in context.wiring if wire.object in ("AXISCORR", "POSCORR")}
        self.holds_corrections = all(e.holdon for e in context.receive if e.indx in feeds)

    # -- state

    @property
    def rsi_state(self) -> RsiState:
        """RSI program state, as reported by the channels."""
        if self.run is not None:
            return self.run.state
        return RsiState.FAULT if self.message is not None else RsiState.IDLE

    @property
    def moving(self) -> bool:
        """Whether the arm is still moving."""
        return self.motion is not None or not self.arm.drives.at_rest

    @property
    def may_move(self) -> bool:
        """Whether a program could move the arm now."""
        return self.drives_on and not self.interlocks.forbids_drives and self.message is None

    def ready(self) -> Acknowledgement:
        """Return DONE if a program may move the arm now, or the reason for refusal."""
        if self.run is not None:
            return Acknowledgement(AckCode.BUSY, "RSI is running")
        if self.motion is not None:
            return Acknowledgement(AckCode.BUSY, "a motion is in progress")
        forbidden = self.interlocks.forbids_program
        if forbidden:
            return Acknowledgement(AckCode.REFUSED, forbidden)
        if self.interlocks.forbids_drives:
            return Acknowledgement(AckCode.NOT_READY, "emergency stop, guard or enabling switch")
        if self.message is not None:
            return Acknowledgement(AckCode.REFUSED, f"message {self.message.number} not acknowledged")
        if not self.drives_on:
            return Acknowledgement(AckCode.NOT_READY, "drives off")
        if self.program_state not in IDLE_PROGRAM_STATES:
            return Acknowledgement(AckCode.REFUSED, f"program is {self.program_state}")
        if self.moving:
            return Acknowledgement(AckCode.BUSY, "arm is moving")
        return DONE

    # -- the program

    def start(
        self,
        cycle_ms: int | None = None,
        relative: bool | None = None,
        correction: str | None = None,
        *,
        counts_from_first_reply: bool = False,
    ) -> Acknowledgement:
        """Execute RSI_ON, using the context's settings unless overridden."""
        answer = self.ready()
        if answer is not DONE:
            return answer
        if correction is not None and not self._wired.get(correction, False):
            return Acknowledgement(AckCode.BAD_VALUE, f"the context corrects no {correction}")
        self.cycle_ms = cycle_ms or self.cycle_ms
        self.relative = self.relative if relative is None else relative
        self.runs += 1
        slow = self.cycle_ms / 1000.0 > IPO_FAST_S
        self.arm.drives.start_cycles(self.cycle_ms / 1000.0, self.parameters.ipo_filter_s if slow else 0.0)
        scales = self.parameters.override_scales_corrections
        settings = RunSettings(
            self.context,
            self.cycle_ms,
            self.relative,
            self.runs,
            counts_from_first_reply,
            needs_confirmation=self.interlocks.manual,
            correction_share=self.override_percent / FULL_OVERRIDE if scales else 1.0,
        )
        self.run = RsiRun(settings, self.arm, self.parameters)
        self.program_state = ProState.ACTIVE
        return DONE

    def cancel(self) -> Acknowledgement:
        """Cancel RSI or a motion, deselect the program and bring the arm to rest."""
        if self.message is not None and self.run is None:
            return Acknowledgement(AckCode.REFUSED, f"message {self.message.number} not acknowledged")
        if self.motion is not None:
            self.arm.drives.brake()
        self._abort_motion("cancelled")
        self._end_run(ProState.FREE)
        return DONE

    def select(self) -> Acknowledgement:
        """Select the program without starting it."""
        if self.run is not None or self.motion is not None or self.message is not None:
            return Acknowledgement(AckCode.REFUSED, f"program is {self.program_state}")
        self.program_state = ProState.RESET
        return DONE

    def stop(self, *, fast: bool = False) -> Acknowledgement:
        """Brake and stop the program without cancelling it, so that RSI may keep streaming."""
        self._interrupt("stopped", fast=fast)
        return DONE

    def acknowledge(self) -> Acknowledgement:
        """Acknowledge the message and reset the program, or answer the question of a running program."""
        if self.interlocks.emergency_stop or self.interlocks.guard_matters:
            return Acknowledgement(AckCode.NOT_READY, "emergency stop or guard")
        if self.message is None and self.run is not None and self.run.awaits_confirmation:
            self.run.confirm()
            return DONE
        self.message = None
        if self.motion is not None:
            self.arm.drives.brake()
        self._abort_motion("program reset")
        self._end_run(ProState.FREE)
        return DONE

    def move(self, motion: EkiMotion) -> None:
        """Start a motion of the EKI program, for which the caller has checked `ready`."""
        self.arm.drives.start_cycles(self.cycle_ms / 1000.0)
        self.motion = motion
        self.program_state = ProState.ACTIVE

    # -- drives and safety

    def switch_drives(self, on: bool) -> Acknowledgement:
        """Switch the drives on, or off to stop the arm."""
        if on and self.interlocks.forbids_drives:
            return Acknowledgement(AckCode.NOT_READY, "emergency stop, guard or enabling switch")
        if not on:
            self._interrupt("drives off")
        self.drives_on = on
        return DONE

    def press_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop, whose message can be acknowledged only after release."""
        self.interlocks.emergency_stop = pressed
        if pressed:
            self._stop_with(self.parameters.emergency_stop_message, "emergency stop")

    def open_guard(self, is_open: bool) -> None:
        """Open or close the safety gate; opening it stops the arm in the automatic modes."""
        self.interlocks.guard_open = is_open
        if self.interlocks.guard_matters:
            self._stop_with(self.parameters.guard_message, "operator safety: guard open")

    def turn_key(self, mode: OperationMode) -> None:
        """Turn the key switch; a mode change stops any running program and switches the drives off."""
        if mode is not self.interlocks.mode:
            self._interrupt(f"mode {mode}")
            self.drives_on = False
        self.interlocks.mode = mode

    def hold_enabling_switch(self, held: bool) -> None:
        """Hold or release the enabling switch; releasing it in a test mode stops the program or motion."""
        self.interlocks.enabling_switch = held
        if self.interlocks.manual and not held:
            if self.run is not None or self.motion is not None:
                self._stop_with(self.parameters.enabling_switch_message, "enabling switch released")
            self.drives_on = False

    def hold_start_key(self, held: bool) -> None:
        """Hold or release the start key; releasing it in a test mode stops the program."""
        self.interlocks.start_key = held
        if self.interlocks.manual and not held and (self.run is not None or self.motion is not None):
            self._interrupt("start key released")

    def collide(self) -> None:
        """Trip the torque monitor, which stops the arm and displays a message."""
        self._stop_with(
            self.parameters.collision_message, "collision detected: torque beyond the monitored range"
        )

    def overload(self) -> None:
        """Close the brakes without a message, so that the program continues but the axes no longer follow."""
        self._overloaded = True
        self.arm.drives.brake()

    @property
    def open_brakes(self) -> int:
        """$BRAKE_SIG: one bit per axis with A1 as the lowest, set when the brake is open."""
        return ALL_BRAKES if self.drives_on and not self._overloaded else 0

    def trip(self, name: str) -> None:
        """End a run or motion with the named message from `TRIPS`."""
        if self.run is not None or self.motion is not None:
            self._fail(TRIPS[name](self.parameters))

    def narrow_corrections(self, within_deg: float | None) -> None:
        """Clamp axis corrections to `within_deg` of their present values, or unclamp them if None."""
        if self.run is not None:
            self.run.flow.narrow(within_deg)

    def restart(self) -> None:
        """End the program without a message, for the caller to restart once the arm is at rest."""
        self.arm.drives.brake()
        self._end_run(ProState.FREE)

    def handle_eki_loss(self) -> None:
        """Handle a lost EKI client, cancelling the RSI program if `eki_loss_cancels` is set."""
        if self.parameters.eki_loss_cancels and self.run is not None:
            self.cancel()

    # -- override and frames

    def set_override(self, percent: int) -> Acknowledgement:
        """Set the override of EKI motions and, by a parameter, of the corrections in later runs."""
        if not 1 <= percent <= FULL_OVERRIDE:
            return Acknowledgement(AckCode.BAD_VALUE, "override is 1 to 100")
        self.override_percent = percent
        return DONE

    def set_tool(self, number: int, frame: Sequence[float]) -> Acknowledgement:
        """Define and activate a $TOOL, X Y Z (mm) A B C (deg) in the flange frame."""
        return self._define(self.arm.set_tool, number, frame)

    def set_base(self, number: int, frame: Sequence[float]) -> Acknowledgement:
        """Define and activate a $BASE, X Y Z (mm) A B C (deg) in $ROBROOT."""
        return self._define(self.arm.set_base, number, frame)

    def _define(
        self, define: Callable[[int, Sequence[float]], None], number: int, frame: Sequence[float]
    ) -> Acknowledgement:
        if self.run is not None or self.motion is not None:
            return Acknowledgement(AckCode.REFUSED, "a program is running")
        define(number, frame)
        return DONE

    # -- the cycle

    def finish_cycle(self, reply: Reply | None) -> None:
        """Complete one cycle of the running program: apply the reply and move the arm."""
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
                self._interrupt("STOP object", fast=run.stops_fast)
            self.arm.settle()
        elif self._overloaded:
            self.arm.settle()
        else:
            self._follow(run.command_deg, has_reply=reply is not None)

    def settle(self) -> None:
        """Run one cycle without RSI: execute the next point of a motion, or move towards rest."""
        motion = self.motion
        if motion is None:
            self.arm.settle()
            return
        command_deg = motion.next_point()
        if command_deg is not None:
            self._follow(command_deg, has_reply=True)
            return
        if motion.message is not None:
            self._fail(motion.message)
            return
        self.arm.settle()
        if self.arm.drives.at_rest:
            self.motion = None
            self.program_state = ProState.END
            motion.report(DONE)

    def _follow(self, command_deg: list[float], *, has_reply: bool) -> None:
        """Advance the arm by one cycle, stopping it in T1 if the tool exceeds the speed limit."""
        if self.interlocks.mode is not OperationMode.T1:
            self.arm.follow(command_deg, has_reply=has_reply)
            return
        before = self.arm.frame
        self.arm.follow(command_deg, has_reply=has_reply)
        speed_mm_s = dist(before[:3], self.arm.frame[:3]) / (self.cycle_ms / 1000.0)
        limit_mm_s = self.parameters.T1_tool_speed_mm_s
        self._fast_cycles = self._fast_cycles + 1 if speed_mm_s > limit_mm_s else 0
        if self._fast_cycles >= self.parameters.overspeed_cycles:
            text = f"T1: tool speed {speed_mm_s:.0f} mm/s, at most {limit_mm_s:.0f}"
            self._fail(PendantMessage(self.parameters.T1_speed_message, text, drives_off=True))

    def _fail(self, message: PendantMessage) -> None:
        self._display(message)
        self.arm.drives.brake()
        self._abort_motion(message.text)
        self._end_run(ProState.STOP)

    def _stop_with(self, number: int, text: str) -> None:
        """Switch the drives off and stop the program with a message, without ending its streaming."""
        self._display(PendantMessage(number, text, drives_off=True))
        self._interrupt(text)

    def _display(self, message: PendantMessage) -> None:
        self.message = self.message or message  # the first one is the cause
        if message.drives_off:
            self.drives_on = False

    def _interrupt(self, reason: str, *, fast: bool = False) -> None:
        self.arm.drives.brake(fast=fast)
        if self.motion is not None:
            self._abort_motion(reason)
            self.program_state = ProState.STOP if self.message is not None else ProState.END
        if self.run is None:
            return
        if self.parameters.streams_after_stop:
            self.run.hold()
            self.program_state = ProState.STOP
        else:
            self._end_run(ProState.STOP)

    def _abort_motion(self, reason: str) -> None:
        motion, self.motion = self.motion, None
        if motion is not None:
            motion.report(Acknowledgement(AckCode.ABORTED, reason))

    def _end_run(self, state: ProState) -> None:
        self.run = None
        self._overloaded = False
        self._fast_cycles = 0
        self.program_state = state
