"""Vocabulary of a Universal Robots controller: ports, RTDE packages and fields, modes, script registers.

RTDE, the Real-Time Data Exchange of the vendor's guide, is a TCP stream of packages: uint16 size with the
header, uint8 type, payload, all big-endian. A reply carries the type of its request. Names of fields are the
controller's own. Angles are in rad, lengths in m, as on the wire.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Final, NamedTuple

PRIMARY_PORT: Final = 30001
SECONDARY_PORT: Final = 30002
REALTIME_PORT: Final = 30003
RTDE_PORT: Final = 30004
DASHBOARD_PORT: Final = 29999
READ_ONLY_PRIMARY_PORT: Final = 30011  # of the client interfaces, without taking scripts
READ_ONLY_SECONDARY_PORT: Final = 30012
READ_ONLY_REALTIME_PORT: Final = 30013

RTDE_HEADER: Final = ">HB"
RTDE_HEADER_BYTES: Final = 3
LONGEST_NAME_LIST_BYTES: Final = 2048  # of the fields that one recipe asks for
NOT_FOUND: Final = "NOT_FOUND"  # in place of a type: no such field
IN_USE: Final = "IN_USE"  # in place of a type: an input that another client or a fieldbus owns
NO_RECIPE: Final = 0
MOST_RECIPES: Final = 255


class PackageType(IntEnum):
    """Type of an RTDE package, an ASCII letter."""

    PROTOCOL_VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")
    MESSAGE = ord("M")
    DATA = ord("U")
    SETUP_OUTPUTS = ord("O")
    SETUP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


class MessageLevel(IntEnum):
    """Level of an RTDE message."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


class FieldType(NamedTuple):
    """Data type of an RTDE field: its name on the wire and its big-endian `struct` codes."""

    name: str
    codes: str


BOOL: Final = FieldType("BOOL", "?")
UINT8: Final = FieldType("UINT8", "B")
UINT32: Final = FieldType("UINT32", "I")
UINT64: Final = FieldType("UINT64", "Q")
INT32: Final = FieldType("INT32", "i")
DOUBLE: Final = FieldType("DOUBLE", "d")
VECTOR3D: Final = FieldType("VECTOR3D", "3d")
VECTOR6D: Final = FieldType("VECTOR6D", "6d")
VECTOR6INT32: Final = FieldType("VECTOR6INT32", "6i")

REGISTERS: Final = 48  # integers and doubles each
CLIENT_REGISTERS: Final = range(24, REGISTERS)  # those below belong to fieldbuses
# The tool changer states the number of the mounted tool, 0 for none, on standard inputs from DI0 on.
TOOL_INPUTS: Final = range(4)  # bits of the digital inputs, the lowest first
BIT_REGISTERS: Final = range(64, 128)  # as single fields; those below come in two words


def _registers(direction: str) -> dict[str, FieldType]:
    return {
        f"{direction}_bit_registers0_to_31": UINT32,
        f"{direction}_bit_registers32_to_63": UINT32,
        **{f"{direction}_bit_register_{number}": BOOL for number in BIT_REGISTERS},
        **{f"{direction}_int_register_{number}": INT32 for number in range(REGISTERS)},
        **{f"{direction}_double_register_{number}": DOUBLE for number in range(REGISTERS)},
    }


OUTPUTS: Final[dict[str, FieldType]] = {
    "timestamp": DOUBLE,
    **dict.fromkeys(
        (
            "target_q",
            "target_qd",
            "target_qdd",
            "target_current",
            "target_moment",
            "actual_q",
            "actual_qd",
            "actual_current",
            "joint_control_output",
            "actual_TCP_pose",
            "actual_TCP_speed",
            "actual_TCP_force",
            "target_TCP_pose",
            "target_TCP_speed",
            "joint_temperatures",
            "actual_joint_voltage",
            "tcp_offset",
            "ft_raw_wrench",
        ),
        VECTOR6D,
    ),
    "actual_digital_input_bits": UINT64,
    "actual_digital_output_bits": UINT64,
    "actual_execution_time": DOUBLE,
    "robot_mode": INT32,
    "joint_mode": VECTOR6INT32,
    "safety_mode": INT32,
    "safety_status": INT32,
    "actual_tool_accelerometer": VECTOR3D,
    "speed_scaling": DOUBLE,
    "target_speed_fraction": DOUBLE,
    "actual_momentum": DOUBLE,
    "actual_main_voltage": DOUBLE,
    "actual_robot_voltage": DOUBLE,
    "actual_robot_current": DOUBLE,
    "runtime_state": UINT32,
    "robot_status_bits": UINT32,
    "safety_status_bits": UINT32,
    "standard_analog_input0": DOUBLE,
    "standard_analog_input1": DOUBLE,
    "standard_analog_output0": DOUBLE,
    "standard_analog_output1": DOUBLE,
    "payload": DOUBLE,
    "payload_cog": VECTOR3D,
    "payload_inertia": VECTOR6D,
    "analog_io_types": UINT32,
    "io_current": DOUBLE,
    "elbow_position": VECTOR3D,
    "elbow_velocity": VECTOR3D,
    "tool_mode": UINT32,
    "tool_analog_input_types": UINT32,
    "tool_analog_input0": DOUBLE,
    "tool_analog_input1": DOUBLE,
    "tool_output_voltage": INT32,
    "tool_output_current": DOUBLE,
    "tool_temperature": DOUBLE,
    "tool_output_mode": UINT8,
    "tool_digital_output0_mode": UINT8,
    "tool_digital_output1_mode": UINT8,
    "tcp_force_scalar": DOUBLE,
    "euromap67_input_bits": UINT32,
    "euromap67_output_bits": UINT32,
    "euromap67_24V_voltage": DOUBLE,
    "euromap67_24V_current": DOUBLE,
    "actual_current_window": VECTOR6D,
    "script_control_line": UINT32,
    **_registers("output"),
    **_registers("input"),  # any client may read inputs back
}

INPUTS: Final[dict[str, FieldType]] = {
    "speed_slider_mask": UINT32,
    "speed_slider_fraction": DOUBLE,
    "standard_digital_output_mask": UINT8,
    "standard_digital_output": UINT8,
    "configurable_digital_output_mask": UINT8,
    "configurable_digital_output": UINT8,
    "tool_digital_output_mask": UINT8,
    "tool_digital_output": UINT8,
    "standard_analog_output_mask": UINT8,
    "standard_analog_output_type": UINT8,
    "standard_analog_output_0": DOUBLE,
    "standard_analog_output_1": DOUBLE,
    "external_force_torque": VECTOR6D,
    **_registers("input"),
}


class RobotMode(IntEnum):
    """`robot_mode`: power and brakes."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    """`safety_mode` and, with 12 and 13, `safety_status`."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    AUTOMATIC_MODE_SAFEGUARD_STOP = 12
    SYSTEM_THREE_POSITION_ENABLING_STOP = 13


class RuntimeState(IntEnum):
    """`runtime_state` of the program."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class RobotStatus(IntFlag):
    """`robot_status_bits`."""

    POWER_ON = 1
    PROGRAM_RUNNING = 2
    TEACH_BUTTON_PRESSED = 4
    POWER_BUTTON_PRESSED = 8


class SafetyStatus(IntFlag):
    """`safety_status_bits`."""

    NORMAL = 1 << 0
    REDUCED = 1 << 1
    PROTECTIVE_STOPPED = 1 << 2
    RECOVERY = 1 << 3
    SAFEGUARD_STOPPED = 1 << 4
    SYSTEM_EMERGENCY_STOPPED = 1 << 5
    ROBOT_EMERGENCY_STOPPED = 1 << 6
    EMERGENCY_STOPPED = 1 << 7
    VIOLATION = 1 << 8
    FAULT = 1 << 9
    STOPPED_DUE_TO_SAFETY = 1 << 10


# Our own URScript exchanges registers in the range of clients. The controller clocks the exchange: every
# cycle it sends its outputs with the sequence number of the set-point used, and uses the newest that arrived.
SCRIPT_NAME: Final = "ronna_stream"
SEQUENCE_INPUT: Final = "input_int_register_24"  # of the set-point; 0 is none yet
ORDER_INPUT: Final = "input_int_register_25"  # ScriptOrder
RUN_INPUT: Final = "input_int_register_26"  # random number of the session: another script's echo is not ours
SET_POINT_INPUTS: Final = tuple(f"input_double_register_{24 + number}" for number in range(6))  # rad
SEQUENCE_OUTPUT: Final = "output_int_register_24"  # of the set-point used in this cycle
STATE_OUTPUT: Final = "output_int_register_25"  # ScriptState
RUN_OUTPUT: Final = "output_int_register_26"


class ScriptSettings(NamedTuple):
    """Settings at the head of our script, one `NAME = VALUE` line each, spelled as the fields here."""

    CYCLE_S: float  # 0.002 for the e-Series, 0.008 for CB3
    STARVED_CYCLES: int  # cycles without a new sequence number before it stops the arm
    LARGEST_STEP_RAD: float  # between two set-points of one joint; a larger one stops the arm
    STOP_DECELERATION_RAD_S2: float  # of stopj
    LOOKAHEAD_S: float  # of servoj, 0.03 to 0.2
    GAIN: float  # of servoj, 100 to 2000


class ScriptOrder(IntEnum):
    """Order to our script."""

    STREAM = 0
    END = 1  # at rest: leave the program


class ScriptState(IntEnum):
    """State reported by our script."""

    NONE = 0
    WAITING = 1  # for the first set-point
    STREAMING = 2
    ENDED = 3  # on our order
    STARVED = 4  # no new set-point for STARVED_CYCLES: stopped
    TOO_FAR = 5  # a set-point farther from the last than LARGEST_STEP_RAD: stopped
