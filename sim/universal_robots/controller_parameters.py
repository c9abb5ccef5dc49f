"""Named and documented parameters for unconfirmed controller behaviour.

The values are best estimates. A driver must live with every alternative; `ronna-sim ur --set NAME=VALUE`
chooses one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from sim.named_parameters import ControllerOfArm, MaximumValue
from sim.universal_robots.errors import UNKNOWN_PARAMETER


@dataclass(frozen=True)
class ControllerParameters(ControllerOfArm):
    """Controller behaviour on which public sources are silent or disagree, in radians and seconds.

    A number with default 0 may be 0; every other number is positive.
    """

    refusal = UNKNOWN_PARAMETER

    # at the start
    start: Annotated[
        Literal["running", "idle", "power_off"], "State after the start; `running` has its brakes released."
    ] = "running"
    programs: Annotated[
        str, "Programs on the controller that the dashboard can load, separated by commas."
    ] = "external_control.urp,wait_program.urp"
    external_control_host: Annotated[
        str, "Client, on this computer, of which a loaded external_control program requests its script."
    ] = "127.0.0.1"
    external_control_port: Annotated[int, "Port of that client.", MaximumValue(65535)] = 50002
    serial_number: Annotated[int, "Serial number, the digits that the dashboard states."] = 20265500001

    # power and safety
    power_on_s: Annotated[float, "From power on to IDLE; others wait 5 s for it, clients up to 30 s."] = 2.0
    booting_share: Annotated[
        float, "Fraction of that time in BOOTING, the rest in POWER_ON.", MaximumValue(1)
    ] = 0.5
    brake_release_s: Annotated[float, "From brake release to RUNNING."] = 1.5
    power_off_s: Annotated[float, "From power off to POWER_OFF."] = 0.5
    protective_stop_lock_s: Annotated[
        float, "Time after a protective stop within which it cannot be unlocked."
    ] = 5.0
    restart_safety_s: Annotated[float, "From restart safety to POWER_OFF, after a violation or fault."] = 2.0
    emergency_power_off_s: Annotated[float, "From an emergency stop to POWER_OFF; the arm rests by then."] = (
        0.5
    )
    after_protective_stop: Annotated[
        Literal["paused", "stopped"], "What a protective stop does to the program."
    ] = "paused"
    after_unlock: Annotated[
        Literal["stays", "resumes"],
        "A paused program stays so when a protective stop is unlocked, or resumes.",
    ] = "stays"
    after_safeguard: Annotated[
        Literal["resumes", "stays"], "A program paused by a safeguard stop resumes when it ends, or stays."
    ] = "resumes"
    local_mode_commands: Annotated[
        Literal["queries", "all"], "Dashboard commands carried out in local mode: queries only, or all."
    ] = "queries"

    software: Annotated[
        Literal["usual", "5.21.0"],
        "Version that an e-Series controller states: 5.11.5, or one from which clients use optimovej.",
    ] = "usual"

    # drives
    drive_delay_cycles: Annotated[int, "Cycles by which the measured joints follow the target."] = 1
    program_stop_rad_s2: Annotated[float, "Deceleration when a program ends with the arm moving."] = 10.0
    protective_stop_rad_s2: Annotated[
        float, "Deceleration of a protective or safeguard stop: 180 deg/s to rest within 500 ms."
    ] = 15.0
    emergency_stop_rad_s2: Annotated[float, "Deceleration of an emergency stop."] = 20.0
    stop_reaction_s: Annotated[float, "From a stop to the begin of braking; at most 24 ms are published."] = (
        0.0
    )
    largest_speed_rad_s: Annotated[float, "Speed above which a joint trips a protective stop."] = 3.3
    servoj_lag_s: Annotated[
        float, "Lag of servoj beyond its lookahead time; 34 ms in all were seen at a lookahead of 0.03 s."
    ] = 0.004
    slider_slows_servoj: Annotated[bool, "The speed slider slows servoj too."] = False

    # forces on the tool, and their estimate
    force_error_scale: Annotated[
        float,
        "Factor on noise and bias of the estimated force: 3 N rms and up to 5 N on CB3, which estimates by "
        "currents, 0.5 N and 2 N on the e-Series.",
    ] = 1.0
    force_lag_s: Annotated[float, "Time constant of the estimated force."] = 0.01
    safety_force_n: Annotated[float, "Force on the tool that trips a protective stop; the usual preset."] = (
        150.0
    )
    tool_mass_kg: Annotated[
        float, "True mass on the flange; 0: as programs set it. A difference appears as a force."
    ] = 0.0
    stiction_share: Annotated[
        float, "Torque that the gears hold at standstill, as a share of the largest of each joint."
    ] = 0.04
    current_noise_a: Annotated[float, "Noise of a measured current of a joint."] = 0.03
    skin_mm: Annotated[float, "Depth of skin in front of bone."] = 5.0
    skin_stiffness_n_mm: Annotated[float, "Resistance of skin for each mm, until it is passed."] = 0.5
    bone_mm: Annotated[float, "Thickness of bone, as of a parietal bone."] = 6.5
    bone_resistance_n: Annotated[float, "Resistance of bone to a drill; more stands for bone undrilled."] = (
        20.0
    )
    friction_n: Annotated[float, "Resistance behind the bone."] = 1.0

    # the arm itself
    factory_calibration: Annotated[
        Literal["linearised", "exact", "none"],
        "Denavit-Hartenberg parameters in the controller: fitted to this arm with small changes, fitted "
        "exactly (axes nearly parallel meet hundreds of metres away), or those of the model.",
    ] = "linearised"
    reversal_deg: Annotated[float, "Reversal after which a joint rests on its other flank."] = 0.0005
    motion_speed_deg_s: Annotated[float, "Speed of a joint at which a new motion begins."] = 0.3

    # RTDE
    newest_rtde_version: Annotated[
        Literal["1", "2"], "Newest protocol version; old controllers know only the first."
    ] = "2"
    send_buffer_bytes: Annotated[
        int, "Unread bytes after which a slow reader is disconnected.", MaximumValue(10_000_000)
    ] = 65536
    most_rtde_clients: Annotated[int, "RTDE connections beyond which new ones are refused; 0: no limit."] = 0
    short_package: Annotated[
        Literal["message", "close", "ignored"], "Answer to a data package shorter than its recipe."
    ] = "message"
    fieldbus_owns: Annotated[
        Literal["nothing", "lower"], "A fieldbus owns nothing, or the input registers 0 to 23."
    ] = "nothing"
    upper_registers: Annotated[bool, "The general purpose registers 24 to 47 exist (since 3.9 and 5.3)."] = (
        True
    )

    # client interfaces
    robot_mode_bytes: Annotated[
        Literal["38", "46", "47"], "Size of the robot mode part: before 3.2, since 3.2, and today."
    ] = "47"
    state_period_s: Annotated[float, "Period of the robot state on the primary interface."] = 0.1
    script_start_s: Annotated[float, "From the end of a script's text to its first cycle; 0: at once."] = 0.0
    longest_script_bytes: Annotated[int, "Text without end beyond which a connection is closed."] = 1_000_000
