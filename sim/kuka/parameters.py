"""What is not known for certain about the controller, each as one named number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


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
    end_switch_message: int = 1205  # number of the software end switch's message: unconfirmed


IPO_FAST_S = 0.004  # cycle of #IPO_FAST, in which the drives work before a program sets another
AUTOSTART_PAUSE_S = 2.0  # an autostarted program begins again this long after its run ended
SUBMIT_CYCLE_S = 0.012  # the submit interpreter writes at most one EKI telegram per loop
