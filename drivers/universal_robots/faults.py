"""Errors for faults of the real-time process that need this controller's words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from drivers.universal_robots.errors import (
    CONTROLLER_RESTARTED,
    CONTROLLER_STOPPED,
    LINK_BROKEN,
    POSE_IMPLAUSIBLE,
    PROGRAM_STOPPED,
    PROTECTIVE_STOP,
    SCRIPT_STOPPED,
)
from drivers.universal_robots.options import UrOptions, script_settings
from drivers.universal_robots.realtime.packages import Cause, ControllerWord
from drivers.universal_robots.safety import NORMAL_MODES, safety_text
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm_stream.faults import StreamFaults
from ronna_hw.arm_stream.records import NOTHING_AROUND, LinkFault, LinkState
from ronna_hw.errors import RonnaError
from ronna_hw.wire.universal_robots import RobotMode, RuntimeState, SafetyMode, ScriptState


@dataclass(frozen=True)
class UrFaults(StreamFaults):
    """Errors of one arm's RTDE stream."""

    options: UrOptions

    def error(
        self, state: LinkState, mode: str, surroundings: Surroundings = NOTHING_AROUND, reported: Any = None
    ) -> RonnaError | None:
        """Build the error for a latched fault, if any."""
        prefix = f"{self.name}: after {state.cycles} cycles"
        match state.fault:
            case LinkFault.CONTROLLER:
                return self._controller_error(prefix, state)
            case LinkFault.BROKEN:
                return LINK_BROKEN(
                    f"{prefix} the RTDE connection broke", got=f"timestamp {state.device_clock} us"
                )
            case LinkFault.RESTARTED:
                return CONTROLLER_RESTARTED(
                    f"{prefix} the controller's time jumped to {state.device_clock} us"
                )
            case LinkFault.BASE:
                return POSE_IMPLAUSIBLE(
                    f"{self.name}: at the start the joints are out of range, or off their commanded angles",
                    got=self.axes_text(state),
                )
        return super().error(state, mode, surroundings)

    def _controller_error(self, prefix: str, state: LinkState) -> RonnaError:
        """Build the error for a stop that the controller reports in its packages."""
        word = ControllerWord.from_number(state.controller_word)
        if (cause := word.cause) == Cause.PROGRAM and word.robot_mode != RobotMode.RUNNING:
            cause = Cause.ROBOT_MODE  # it came later: power going off stops the program first
        elif cause == Cause.PROGRAM and word.safety_mode not in NORMAL_MODES:
            cause = Cause.SAFETY
        match cause:
            case Cause.SAFETY if word.safety_mode in NORMAL_MODES:
                return CONTROLLER_STOPPED(
                    f"{prefix} the safety mode is {safety_text(word.safety_mode)}",
                    expected="the mode for whose speed limits the stream was started",
                )
            case Cause.SAFETY if word.safety_mode == SafetyMode.PROTECTIVE_STOP:
                return PROTECTIVE_STOP(f"{prefix} the controller stopped the arm: protective stop")
            case Cause.SAFETY:
                return CONTROLLER_STOPPED(
                    f"{prefix} the controller stopped the arm: {safety_text(word.safety_mode)}"
                )
            case Cause.ROBOT_MODE:
                return CONTROLLER_STOPPED(
                    f"{prefix} the arm was switched off", expected=RobotMode.RUNNING.name, got=word.text
                )
            case Cause.OTHER_SCRIPT:
                return PROGRAM_STOPPED(f"{prefix} another program took the place of ours", got=word.text)
            case Cause.SCRIPT if word.script_state == ScriptState.TOO_FAR:
                limit_rad = script_settings(self.options).LARGEST_STEP_RAD
                return SCRIPT_STOPPED(
                    f"{prefix} our script refused a step between two set-points", limit=f"{limit_rad:.4f} rad"
                )
            case Cause.SCRIPT if word.script_state == ScriptState.STARVED:
                starved_s = script_settings(self.options).STARVED_CYCLES * self.options.cycle_s
                return SCRIPT_STOPPED(
                    f"{prefix} no set-point reached our script in time, and it stopped the arm",
                    limit=f"{starved_s * 1e3:g} ms",
                )
            case _:
                return PROGRAM_STOPPED(f"{prefix} our program was stopped or paused", got=word.text)


def may_be_power(state: LinkState) -> bool:
    """Return whether our program has stopped for a reason that the robot mode may still tell."""
    word = ControllerWord.from_number(state.controller_word)
    return (
        state.fault is LinkFault.CONTROLLER
        and word.cause == Cause.PROGRAM
        and word.runtime_state in (RuntimeState.STOPPING, RuntimeState.STOPPED)
        and word.robot_mode == RobotMode.RUNNING
        and word.safety_mode in NORMAL_MODES
    )
