"""Data packages of the stream: what the controller reports each cycle, and the set-point that answers it."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Final, NamedTuple

from ronna_hw.wire import universal_robots as wire
from ronna_hw.wire.universal_robots import PackageType, ScriptOrder

OUTPUT_FIELDS: Final = (
    "timestamp",
    "target_q",
    "actual_q",
    "speed_scaling",
    "target_speed_fraction",
    "robot_mode",
    "safety_mode",
    "runtime_state",
    wire.SEQUENCE_OUTPUT,
    wire.STATE_OUTPUT,
    wire.RUN_OUTPUT,
    "actual_TCP_force",
    "actual_current",
    "target_current",
)
INPUT_FIELDS: Final = (wire.SEQUENCE_INPUT, wire.ORDER_INPUT, wire.RUN_INPUT, *wire.SET_POINT_INPUTS)

HEADER: Final = struct.Struct(wire.RTDE_HEADER)
RECIPE: Final = "B"
HEAD: Final = struct.Struct(wire.RTDE_HEADER + RECIPE)  # what each data package begins with
OUTPUT_CODES = [wire.OUTPUTS[name].codes for name in OUTPUT_FIELDS]
OUTPUT: Final = struct.Struct("".join([HEAD.format, *OUTPUT_CODES]))
INPUT: Final = struct.Struct("".join([HEAD.format, *(wire.INPUTS[name].codes for name in INPUT_FIELDS)]))
START_REQUEST: Final = HEADER.pack(wire.RTDE_HEADER_BYTES, PackageType.START)

# Places of the values in an unpacked output package.
TYPE, RECIPE_ID, TIMESTAMP = 1, 2, 3
TARGET, ACTUAL = slice(4, 10), slice(10, 16)
SPEED_SCALING, SPEED_FRACTION, ROBOT_MODE, SAFETY_MODE, RUNTIME_STATE = range(16, 21)
ECHO, SCRIPT_STATE, RUN = range(21, 24)
FORCE = slice(24, 27)  # on the tool centre point, in the base; torques follow
CURRENTS, EXPECTED_CURRENTS = slice(30, 36), slice(36, 42)  # A
STATUS = slice(SPEED_SCALING, RUN + 1)  # everything that must be as expected to send a prepared reply

# The same in the bytes, to be compared before anything else is decoded.
_STATUS_FIELDS = slice(OUTPUT_FIELDS.index("speed_scaling"), OUTPUT_FIELDS.index(wire.RUN_OUTPUT) + 1)
STATUS_OFFSET: Final = HEAD.size + struct.calcsize(">" + "".join(OUTPUT_CODES[: _STATUS_FIELDS.start]))
STATUS_BYTES: Final = struct.Struct(">" + "".join(OUTPUT_CODES[_STATUS_FIELDS]))
TIMESTAMP_OFFSET: Final = HEAD.size
TIMESTAMP_BYTES: Final = struct.Struct(">" + OUTPUT_CODES[0])

Output = tuple[float, ...]  # an unpacked output package


class Cause(IntEnum):
    """Why the controller's own report ended a stream."""

    NONE = 0
    SAFETY = 1  # the safety mode is not that of the limits
    ROBOT_MODE = 2  # power or brakes
    PROGRAM = 3  # the program was stopped or paused
    SCRIPT = 4  # our script has stopped the arm
    OTHER_SCRIPT = 5  # another program runs in place of ours


class ControllerWord(NamedTuple):
    """State reported by the controller, packed into one number of the link state."""

    robot_mode: int
    safety_mode: int
    runtime_state: int
    script_state: int
    cause: int = Cause.NONE

    @property
    def number(self) -> int:
        """All values in one number, a byte each; the robot mode may be -1."""
        packed = 0
        for place, value in enumerate((self.robot_mode + 1, *self[1:])):
            packed |= (value & 0xFF) << 8 * place
        return packed

    @classmethod
    def from_number(cls, number: int) -> ControllerWord:
        """Unpack a number made by `number`."""
        values = [number >> 8 * place & 0xFF for place in range(5)]
        return cls(values[0] - 1, *values[1:])

    @property
    def text(self) -> str:
        """The values in words."""
        return (
            f"robot mode {_name(wire.RobotMode, self.robot_mode)}, "
            f"safety mode {_name(wire.SafetyMode, self.safety_mode)}, "
            f"program {_name(wire.RuntimeState, self.runtime_state)}, "
            f"script {_name(wire.ScriptState, self.script_state)}"
        )


def encode_input(
    recipe: int, sequence: int, order: ScriptOrder, run: int, joints_rad: tuple[float, ...]
) -> bytes:
    """Encode a set-point."""
    return INPUT.pack(INPUT.size, PackageType.DATA, recipe, sequence, order, run, *joints_rad)


def _name(kind: type[IntEnum], value: int) -> str:
    try:
        return kind(value).name
    except ValueError:
        return str(value)
