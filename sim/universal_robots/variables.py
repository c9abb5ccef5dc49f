"""Variables of the data exchange: one flat list, with the place of each field in it.

A recipe picks its places with one call, so that a package costs no dictionary. Inputs can be read back as
outputs: both have the same place.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

from ronna_hw.wire.universal_robots import INPUTS, OUTPUTS, FieldType


def _count(kind: FieldType) -> int:
    digits = kind.codes[:-1]
    return int(digits) if digits else 1


def _place_fields() -> tuple[dict[str, slice], list[Any]]:
    places: dict[str, slice] = {}
    values: list[Any] = []
    for name, kind in {**OUTPUTS, **INPUTS}.items():
        count = _count(kind)
        places[name] = slice(len(values), len(values) + count)
        values += [{"d": 0.0, "?": False}.get(kind.codes[-1], 0)] * count
    return places, values


PLACES, INITIAL_VALUES = _place_fields()


def index(name: str) -> int:
    """Return the place of a scalar field."""
    return int(PLACES[name].start)


def indices(names: Iterable[str]) -> tuple[int, ...]:
    """Return the index of each number in these fields; a vector has one for each element."""
    return tuple(number for name in names for number in range(PLACES[name].start, PLACES[name].stop))


TIMESTAMP: Final = index("timestamp")
ROBOT_MODE: Final = index("robot_mode")
SAFETY_MODE: Final = index("safety_mode")
SAFETY_STATUS: Final = index("safety_status")
RUNTIME_STATE: Final = index("runtime_state")
ROBOT_STATUS: Final = index("robot_status_bits")
SAFETY_BITS: Final = index("safety_status_bits")
SPEED_SCALING: Final = index("speed_scaling")
TARGET_SPEED_FRACTION: Final = index("target_speed_fraction")
DIGITAL_OUTPUTS: Final = index("actual_digital_output_bits")
DIGITAL_INPUTS: Final = index("actual_digital_input_bits")
PAYLOAD: Final = index("payload")
INPUT_INTS: Final = index("input_int_register_0")
INPUT_DOUBLES: Final = index("input_double_register_0")
OUTPUT_INTS: Final = index("output_int_register_0")
OUTPUT_DOUBLES: Final = index("output_double_register_0")
