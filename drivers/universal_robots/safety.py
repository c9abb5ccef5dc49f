"""Errors of safety and robot modes, with the advice for each."""

from __future__ import annotations

from drivers.universal_robots.errors import EMERGENCY_STOPPED, PROTECTIVELY_STOPPED
from ronna_hw.devices.capabilities import EMERGENCY_STOP
from ronna_hw.wire.universal_robots import SafetyMode

NORMAL_MODES = (SafetyMode.NORMAL, SafetyMode.REDUCED)
EMERGENCY_MODES = (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)
# Left only by a restart of the safety system, after which the arm is switched off.
RESTART_MODES = (SafetyMode.VIOLATION, SafetyMode.FAULT)
SAFETY_REFUSALS = {  # errors of a start in these modes; in others than normal ones SAFETY_STOPPED
    **dict.fromkeys(EMERGENCY_MODES, EMERGENCY_STOPPED),
    SafetyMode.PROTECTIVE_STOP: PROTECTIVELY_STOPPED,
}

_WORDS = {
    SafetyMode.REDUCED: "reduced mode",
    SafetyMode.PROTECTIVE_STOP: "protective stop",
    SafetyMode.RECOVERY: "recovery mode: the arm is outside its safety planes",
    SafetyMode.SAFEGUARD_STOP: "safeguard stop",
    SafetyMode.SYSTEM_EMERGENCY_STOP: f"{EMERGENCY_STOP} of the system pressed",
    SafetyMode.ROBOT_EMERGENCY_STOP: f"{EMERGENCY_STOP} of the robot pressed",
    SafetyMode.VIOLATION: "violation of a safety limit",
    SafetyMode.FAULT: "fault of the safety system",
    SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP: "safeguard stop of the automatic mode",
    SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP: "stop by the three-position enabling device",
}


def safety_text(mode: int) -> str:
    """Return a safety mode in words."""
    try:
        return _WORDS.get(SafetyMode(mode), SafetyMode(mode).name.lower())
    except ValueError:
        return f"safety mode {mode}"
