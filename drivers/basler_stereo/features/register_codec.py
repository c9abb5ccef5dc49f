"""Register bytes to values and back, as defined by a node of the camera's description."""

from __future__ import annotations

import math
import struct
from typing import Literal

from drivers.basler_stereo.errors import BadDescription
from drivers.basler_stereo.features.description import Node, whole_number
from drivers.basler_stereo.features.formula import Number

_FLOATS = {4: "f", 8: "d"}


def register_length(node: Node) -> int:
    """Length of a register in bytes; raises GEV-009."""
    length = whole_number(node.text("Length"), f"length of {node.name}")
    if length not in (_FLOATS if node.kind == "FloatReg" else (1, 2, 4, 8)):
        raise BadDescription(f"{node.name} has a length of {length} bytes")
    return length


def shares_register(node: Node) -> bool:
    """Whether a node uses only some bits of its register, so that writing must preserve the others."""
    length = register_length(node)
    return register_bits(node, length)[1] < 8 * length


def decode_register(node: Node, data: bytes) -> Number:
    """The value in the bytes of a register."""
    if node.kind == "FloatReg":
        number = float(struct.unpack(_float_layout(node, len(data)), data)[0])
        if not math.isfinite(number):
            raise BadDescription(f"{node.name} reads {number}", expected="a finite number")
        return number
    low, width = register_bits(node, len(data))
    value = int.from_bytes(data, _byte_order(node)) >> low & (1 << width) - 1
    return value - (1 << width) if _is_signed(node) and value >> (width - 1) else value


def encode_register(node: Node, value: Number, current: bytes = b"") -> bytes:
    """The bytes that set a register to a value; `current`: its present bytes, for the bits to preserve."""
    length = register_length(node)
    if node.kind == "FloatReg":
        try:
            return struct.pack(_float_layout(node, length), float(value))
        except OverflowError as error:
            raise BadDescription(f"{node.name} cannot hold {value:g}", limit=f"{length} bytes") from error
    low, width = register_bits(node, length)
    mask = (1 << width) - 1
    number = round(value)
    least = -(1 << width - 1) if _is_signed(node) else 0
    if not least <= number <= least + mask:
        raise BadDescription(f"{node.name} cannot hold {number}", limit=f"{least} to {least + mask}")
    others = int.from_bytes(current, _byte_order(node)) & ~(mask << low)
    return (others | (number & mask) << low).to_bytes(length, _byte_order(node))


def _is_signed(node: Node) -> bool:
    return (node.text("Sign") or "Unsigned") == "Signed"


def register_bits(node: Node, length: int) -> tuple[int, int]:
    """Lowest bit and number of bits of a register's value.

    In a big-endian register the description counts bits from the most significant one.
    """
    if node.kind != "MaskedIntReg":
        return 0, 8 * length
    single = node.text("Bit")
    ends = [
        whole_number(single if single is not None else node.text(tag), node.name) for tag in ("LSB", "MSB")
    ]
    if _byte_order(node) == "big":
        ends = [8 * length - 1 - end for end in ends]
    low, high = min(ends), max(ends)
    if low < 0 or high >= 8 * length:
        raise BadDescription(f"{node.name} uses bits outside its {length} bytes")
    return low, high - low + 1


def _byte_order(node: Node) -> Literal["big", "little"]:
    return "big" if node.text("Endianess") == "BigEndian" else "little"


def _float_layout(node: Node, length: int) -> str:
    return (">" if _byte_order(node) == "big" else "<") + _FLOATS[length]
