"""Readiness of a Universal Robots controller by its reports, and the number of the mounted tool."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from drivers.universal_robots.errors import UNLOCK_WAIT, RegistersInUse
from drivers.universal_robots.primary.client import ControllerState
from drivers.universal_robots.safety import EMERGENCY_MODES, NORMAL_MODES, RESTART_MODES, safety_text
from ronna_hw.devices.capabilities import EMERGENCY_STOP, MESSAGES, Fact
from ronna_hw.wire.universal_robots import RobotMode, SafetyMode


def read_tool_number(digital_inputs: int, bits: Sequence[int]) -> int:
    """Return the number that digital inputs carry, the least significant bit first."""
    return sum((digital_inputs >> bit & 1) << place for place, bit in enumerate(bits))


def controller_facts(state: ControllerState) -> Iterator[Fact]:
    """Yield the controller's status. An arm that is off is no objection: `activate` switches it on."""
    safety, mode = state.safety_mode, state.mode
    is_pressed = mode.is_emergency_stopped or safety in EMERGENCY_MODES
    yield Fact(
        EMERGENCY_STOP, "pressed" if is_pressed else "released", not is_pressed, "Release the emergency stop."
    )
    needs_person = safety in (SafetyMode.PROTECTIVE_STOP, *RESTART_MODES)
    yield Fact(
        MESSAGES,
        safety_text(safety) if needs_person else "none to acknowledge",
        not needs_person,
        f"Find its cause at the arm; acknowledge it with ronna-procedure acknowledge: {UNLOCK_WAIT}."
        if safety is SafetyMode.PROTECTIVE_STOP
        else "Find its cause at the arm; acknowledge it with ronna-procedure acknowledge.",
    )
    yield Fact(
        "safety mode",
        safety_text(safety),
        safety in NORMAL_MODES or is_pressed or needs_person,
        "Reset the safeguard, or lead the arm back at the pendant.",
    )
    is_on = mode.robot_mode == RobotMode.RUNNING
    yield Fact("drives", "on" if is_on else "off; switched on when the case begins")
    yield Fact(
        "speed slider",
        f"{mode.speed_fraction:.0%}",
        mode.speed_fraction > 0.0,
        "Raise the speed slider at the bottom of the pendant's screen.",
    )


def readiness_facts(
    state: ControllerState, *, remote: bool | None, running: bool, registers: str
) -> Iterator[Fact]:
    """Yield every condition that `activate` checks.

    `remote` is None for a controller without that mode. `registers` says who has them; empty: nobody.
    """
    if remote is not None:
        yield Fact(
            "control",
            "remote" if remote else "local",
            remote,
            "Choose remote control on the pendant's screen.",
        )
    yield from controller_facts(state)
    yield Fact(
        "program",
        "running" if running else "none running",
        not running,
        "Another program runs: stop it at the pendant.",
    )
    yield Fact("registers", registers or "free", not registers, RegistersInUse.action)
    yield Fact(
        "at rest", "moving" if state.moving else "yes", not state.moving, "Wait until the arm is at rest."
    )
