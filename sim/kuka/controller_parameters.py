"""Named and documented parameters for unconfirmed controller behaviour.

The values are best estimates. A driver must live with every alternative; `ronna-sim kuka --set NAME=VALUE`
chooses one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from ronna_hw.arm.motion.limits import REDUCED_SPEED_MM_S
from ronna_hw.wire.kuka_eki import FIRST_REQUEST_LIMIT_MS
from sim.kuka.errors import UNKNOWN_PARAMETER
from sim.named_parameters import ControllerOfArm, MaximumValue


@dataclass(frozen=True)
class ControllerParameters(ControllerOfArm):
    """Controller behaviour on which public sources are silent or disagree, in degrees, seconds and cycles.

    A number with default 0 may be 0; every other number is positive.
    """

    refusal = UNKNOWN_PARAMETER

    # drives
    dead_time_cycles: Annotated[
        int, "Cycles from a reply to the first movement; 2 to 3 were observed on a robot."
    ] = 2
    lag_s: Annotated[
        float, "Time constant of the drives, first order; 10 to 30 ms are published.", MaximumValue(1.0)
    ] = 0.015
    ipo_filter_s: Annotated[
        float, "First-order filter of corrections in a 12 ms run (#IPO); 0: none. #IPO_FAST has none."
    ] = 0.012
    readout_step_deg: Annotated[
        float, "Resolution of the measured axes; 0: finer than the reported digits."
    ] = 0.0
    rest_error_deg: Annotated[float, "The servo is in position within this distance of its command."] = 0.0005
    # One value held over one lost reply at 1/8 of full speed makes a step of 2/8, which passes.
    step_share: Annotated[
        float, "Fraction of the axis's full-speed step above which a commanded step trips the drives."
    ] = 0.25
    overspeed_cycles: Annotated[int, "Consecutive cycles above the axis limit that trip the drives."] = 3
    # Over a time rather than from cycle to cycle, so that one held value and the step after it pass.
    acceleration_window_s: Annotated[float, "Time over which an acceleration is judged."] = 0.040
    acceleration_share: Annotated[
        float,
        "Largest commanded acceleration, as a multiple of a planner's; the drives' limit is not public.",
    ] = 1.5
    acceleration_cycles: Annotated[
        int, "Consecutive cycles of excessive acceleration that trip the drives."
    ] = 3
    held_cycles: Annotated[int, "Values held over this many lost replies do not split a motion in two."] = 3
    at_end_switch: Annotated[
        Literal["stop", "clamp"], "A command beyond a software end switch stops the arm, or is clamped to it."
    ] = "stop"
    path_stop_share: Annotated[float, "Fraction of the axis accelerations used by a stop."] = 1.0
    fast_stop_share: Annotated[float, "The same for STOP FAST."] = 2.0
    # A joint changes flanks when the command moves back by more than this from its extreme.
    reversal_deg: Annotated[float, "Reversal after which a joint rests on its other flank."] = 0.0005
    # Above the last step of a jerk-limited profile (1.2 thousandths of a degree in 4 ms), so that the number
    # of motions depends on the commands and not on the pauses between them.
    motion_speed_deg_s: Annotated[float, "Speed of the command at which a new motion begins."] = 0.3
    stick_breakaway_deg: Annotated[
        float, "A sticking axis slips when the command is this far ahead of it."
    ] = 0.05

    # motor currents
    stiction_share: Annotated[
        float, "Torque that the gears hold at standstill, as a share of that of the largest current."
    ] = 0.05
    current_error_share: Annotated[
        float, "Deviation of each drive's current per torque from its design, one standard deviation."
    ] = 0.05
    current_noise_percent: Annotated[float, "Noise of a current, in percent of the largest."] = 0.3
    current_cycles: Annotated[int, "Cycles from one value of the currents to the next."] = 3

    # RSI: telegrams and replies
    ipoc_start: Annotated[
        int, "Time stamp from which those of the runs are derived.", MaximumValue(2**64 - 1)
    ] = 4_208_163_632
    ipoc_bits: Annotated[int, "Bits of the time stamp: 32 wraps after 49 days.", MaximumValue(64)] = 32
    delay_tells: Annotated[
        Literal["total", "in_a_row", "nothing"],
        "D: late replies since RSI_ON, consecutive late replies up to now, or always 0.",
    ] = "total"
    delay_lag_cycles: Annotated[int, "Number of telegrams by which D lags behind."] = 0
    stat_tells_limits: Annotated[
        bool, "Stat has bits for limits in addition to bit 0, correction active."
    ] = True
    reply_window: Annotated[
        float,
        "Fraction of the cycle within which a reply is in time; lock-step mode waits for it.",
        MaximumValue(1.0),
    ] = 1.0
    second_reply: Annotated[
        Literal["ignored", "taken"], "A second reply to the same telegram, in the same cycle."
    ] = "ignored"
    missing_element: Annotated[
        Literal["holdon", "kept", "zero"],
        "An element missing from a reply: treated by its HOLDON as if the reply were missing, kept, or 0.",
    ] = "holdon"
    reads_exponents: Annotated[bool, "A number such as 1.5e-3 is accepted."] = True
    bad_number: Annotated[
        Literal["no_reply", "missing"],
        "NaN, inf or text instead of a number invalidates the reply, or its element.",
    ] = "no_reply"
    longest_file_name: Annotated[
        int, "Characters of an Ethernet file's name without extension; some KSS 8.5.8 accept fewer than 20."
    ] = 255

    # RSI: the run
    streams_from: Annotated[
        Literal["rsi_on", "movecorr"], "Telegrams start at RSI_ON, or with RSI_MOVECORR."
    ] = "rsi_on"
    corrections_act: Annotated[
        Literal["movecorr", "rsi_on"], "Corrections act in RSI_MOVECORR only, or from RSI_ON."
    ] = "movecorr"
    movecorr_after_cycles: Annotated[int, "Cycles from RSI_ON to RSI_MOVECORR."] = 3
    timeout_counting: Annotated[
        Literal["consecutive", "total"], "Timeout counts consecutive late replies, or all since RSI_ON."
    ] = "consecutive"
    streams_after_stop: Annotated[bool, "A stopped but not cancelled program keeps sending."] = True
    override_scales_corrections: Annotated[bool, "The program override at RSI_ON scales corrections too."] = (
        False
    )

    # EKI
    eki_loss_cancels: Annotated[bool, "The loss of an EKI connection ends the RSI program."] = False
    first_request_s: Annotated[
        float, "Host time after which a client of our EKI program that sent no request is disconnected."
    ] = FIRST_REQUEST_LIMIT_MS / 1000.0
    longest_text: Annotated[int, "Longest KRL string in an EKI element, in characters."] = 512
    serial_number: Annotated[int, "$KR_SERIALNO in the State: taken for an INT that every KR C4 has."] = (
        601234
    )
    reports_brakes: Annotated[
        bool, "The State has $BRAKE_SIG: a bit for each axis, 1 for an open brake. Otherwise it is empty."
    ] = True
    inverted_status: Annotated[int, "Bits of S in E6POS with the opposite meaning.", MaximumValue(7)] = 0
    line_acceleration_mm_s2: Annotated[float, "Acceleration of a LIN of the EKI program."] = 1000.0
    line_turn_rad_s: Annotated[float, "Largest angular velocity of the tool on a LIN."] = 1.0

    # T1
    T1_axis_speed_share: Annotated[
        float, "Fraction of the axis speed limits, for motions of the EKI program."
    ] = 0.10
    T1_tool_speed_mm_s: Annotated[float, "The arm is stopped above this speed, by EKI or RSI."] = (
        REDUCED_SPEED_MM_S
    )

    # message numbers for which there is no public source
    end_switch_message: Annotated[int, "Number of the message: software end switch."] = 1205
    emergency_stop_message: Annotated[int, "Number of the message: emergency stop."] = 1
    guard_message: Annotated[int, "Number of the message: guard open."] = 6
    enabling_switch_message: Annotated[int, "Number of the message: enabling switch released."] = 26
    collision_message: Annotated[int, "Number of the message: collision."] = 117
    T1_speed_message: Annotated[int, "Number of the message: too fast for T1."] = 421


IPO_FAST_S = 0.004  # cycle of #IPO_FAST, used by the drives until a program sets another
AUTOSTART_PAUSE_S = 2.0  # pause before an autostarted program restarts after a run
SUBMIT_CYCLE_S = 0.012  # the submit interpreter reads and writes at most one EKI telegram per loop
