"""What is not known for certain about the controller, each as one named number."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, get_args, get_type_hints

from sim.kuka.errors import UnknownParameter


@dataclass(frozen=True)
class ControllerParameters:
    """How this controller behaves where public sources are silent or disagree. Degrees, seconds, cycles."""

    dead_time_cycles: int = 2  # reply to first movement: 2 to 3 cycles were seen on a robot
    lag_s: float = 0.015  # first order; 10 to 30 ms are published
    rest_error_deg: float = 0.0005  # nearer than this the servo has arrived; below the arm's read-out
    # A commanded step above this share of the axis's full-speed step trips the drives. One held value
    # after one lost reply at 1/8 of full speed is a step of 2/8, which passes.
    step_share: float = 0.25
    overspeed_cycles: int = 3  # the axis limit may be exceeded for fewer cycles than this
    # Acceleration is judged over this time and not from cycle to cycle, and only when too much of it lasts,
    # so that one held value and the step after it pass. The share is of the planner's accelerations; what
    # the drives bear is not public.
    acceleration_window_s: float = 0.040
    acceleration_share: float = 1.5
    acceleration_cycles: int = 3
    held_cycles: int = 3  # values held over so many lost replies do not break a motion in two
    movecorr_after_cycles: int = 3  # telegrams between RSI_ON and the moment corrections act
    timeout_counting: Literal["consecutive", "total"] = "consecutive"
    streams_after_stop: bool = True  # a stopped but not cancelled program keeps sending
    # A joint reverses its flank when the command comes back by more than this from its extreme.
    reversal_deg: float = 0.0005
    # A new motion begins when the command moves faster than this. It is above the last step of a
    # jerk-limited profile (1.2 thousandths of a degree in 4 ms), so that motions are counted by what is
    # commanded and not by how long the arm waited between them.
    motion_speed_deg_s: float = 0.3
    path_stop_share: float = 1.0  # share of the axis accelerations that a stop uses
    fast_stop_share: float = 2.0  # the same for STOP FAST
    line_acceleration_mm_s2: float = 1000.0  # of a LIN of the EKI program
    line_turn_rad_s: float = 1.0  # fastest turn of the tool on a LIN
    T1_axis_speed_share: float = 0.10  # of the axis limits, for motions of the EKI program in T1
    T1_tool_speed_mm_s: float = 250.0
    stick_breakaway_deg: float = 0.05  # a sticking axis slips when the command is this far ahead of it
    # Numbers of messages that no public source tells.
    end_switch_message: int = 1205
    emergency_stop_message: int = 1
    guard_message: int = 6
    enabling_switch_message: int = 26
    collision_message: int = 117
    T1_speed_message: int = 421


def changed_parameters(assignments: Iterable[str]) -> ControllerParameters:
    """The parameters with some set by `NAME=VALUE`; raises KRC-003 for an unknown name or a wrong value."""
    parameters = ControllerParameters()
    hints = get_type_hints(ControllerParameters)
    for assignment in assignments:
        name, _, text = assignment.partition("=")
        if name not in hints:
            known = ", ".join(asdict(parameters))
            raise UnknownParameter(f"the controller has no parameter {name!r}", awaited=f"one of {known}")
        parameters = replace(parameters, **{name: _value(name, hints[name], text)})
    return parameters


def _value(name: str, kind: Any, text: str) -> Any:
    choices = {"true": True, "false": False} if kind is bool else {item: item for item in get_args(kind)}
    if choices:
        if text not in choices:
            raise UnknownParameter(f"{name} cannot be {text!r}", awaited=" or ".join(choices))
        return choices[text]
    try:
        value = kind(text)
    except ValueError:
        raise UnknownParameter(f"{name} cannot be {text!r}", awaited=f"a {kind.__name__}") from None
    if not 0 < value < float("inf"):
        raise UnknownParameter(f"{name} cannot be {text}", awaited="a number above 0")
    return value


IPO_FAST_S = 0.004  # cycle of #IPO_FAST, in which the drives work before a program sets another
AUTOSTART_PAUSE_S = 2.0  # an autostarted program begins again this long after its run ended
SUBMIT_CYCLE_S = 0.012  # the submit interpreter reads and writes at most one EKI telegram per loop
