"""Contents of the OpenIGTLink types that we send or take, and the names of the queries for them.

Matrices are 4 x 4, lengths in mm, quaternions scalar last, as on the wire. Decoders raise Malformed, also for
numbers that are not finite.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Iterator, Sequence
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ronna_hw.vectors import Vector3
from ronna_hw.wire.openigtlink import (
    ASCII,
    LONGEST_NAME_BYTES,
    LONGEST_TYPE_BYTES,
    UTF_8,
    Malformed,
    decode_text,
    encode_text,
)

Matrix = NDArray[np.float64]
TRANSFORM_QUERIES: Final = ("GET_TRANS", "GET_TRANSFOR")  # of the reference library, and of the document
TRACKING_6D: Final = 2  # kinds of an instrument in TDATA
TRACKING_3D: Final = 3
TRACKING_5D: Final = 4
_FLOATS12: Final = struct.Struct(">12f")
_TOOL: Final = struct.Struct(">20sBB12f")
_QUATERNION_TOOL: Final = struct.Struct(">20sBB7f")
_STATUS: Final = struct.Struct(">Hq20s")
_STRING: Final = struct.Struct(">HH")
_POINT: Final = struct.Struct(">64s32s4B3ff20s")
_LINE: Final = struct.Struct(">64s32sBB4B3f3ff20s")
_IMAGE: Final = struct.Struct(">HBBBB3H12f6H")
_COMMAND: Final = struct.Struct(">I128sHI")
_START: Final = struct.Struct(">I32s")
LONGEST_STRING_BYTES: Final = 65_535
LONGEST_POINT_NAME_BYTES: Final = 64
LONGEST_GROUP_BYTES: Final = 32
LONGEST_COMMAND_BYTES: Final = 128
LONGEST_FRAME_BYTES: Final = 32
UNIT_TOLERANCE: Final = 1e-3  # of a quaternion in single precision, as some peers round it
_LINE_WITH_BOTH_ENDS: Final = 3
_LITTLE_ENDIAN: Final = 2


class StatusCode(IntEnum):
    """Code of a STATUS; the others of the document are not used here."""

    OK = 1
    ACCESS_DENIED = 5
    BUSY = 6
    TIME_OUT = 7
    CHECKSUM_ERROR = 9
    CONFIGURATION_ERROR = 10
    UNKNOWN_INSTRUCTION = 12
    NOT_READY = 13
    HARDWARE_FAILURE = 18
    SHUTTING_DOWN = 19


class Status(NamedTuple):
    """State of a device: code, our own number in it, a short name of the error, and a text."""

    code: int
    text: str
    error: str = ""
    sub_code: int = 0


class TrackedTool(NamedTuple):
    """Instrument in a TDATA or QTDATA."""

    name: str
    kind: int
    pose: Matrix


class Command(NamedTuple):
    """COMMAND or RTS_COMMAND."""

    number: int
    name: str
    text: str


class Subscription(NamedTuple):
    """STT_TDATA or STT_QTDATA: the shortest interval that the client wants, and the frame."""

    interval_ms: int
    frame: str


class ScalarType(IntEnum):
    """Type of a voxel or pixel."""

    UINT8 = 3
    INT16 = 4
    UINT16 = 5


class CoordinateSystem(IntEnum):
    """Patient coordinates in which an image is placed."""

    RAS = 1
    LPS = 2


def encode_transform(matrix: ArrayLike) -> bytes:
    """Encode a TRANSFORM: the three columns of the rotation, then the translation."""
    return _FLOATS12.pack(*_columns(matrix))


def decode_transform(content: bytes) -> Matrix:
    """Decode a TRANSFORM."""
    return _matrix(_unpack(_FLOATS12, content, "TRANSFORM"))


def encode_tracking(tools: Iterable[TrackedTool]) -> bytes:
    """Encode a TDATA."""
    return b"".join(_TOOL.pack(_tool_name(tool), tool.kind, 0, *_columns(tool.pose)) for tool in tools)


def decode_tracking(content: bytes) -> tuple[TrackedTool, ...]:
    """Decode a TDATA."""
    tools = _unpack_tools(_TOOL, content, "TDATA")
    return tuple(TrackedTool(name, kind, _matrix(numbers)) for name, kind, numbers in tools)


def encode_quaternion_tracking(tools: Iterable[TrackedTool]) -> bytes:
    """Encode a QTDATA."""
    return b"".join(
        _QUATERNION_TOOL.pack(_tool_name(tool), tool.kind, 0, *tool.pose[:3, 3], *_quaternion(tool.pose))
        for tool in tools
    )


def decode_quaternion_tracking(content: bytes) -> tuple[TrackedTool, ...]:
    """Decode a QTDATA."""
    tools = []
    for name, kind, (x, y, z, *quaternion) in _unpack_tools(_QUATERNION_TOOL, content, "QTDATA"):
        if not math.isclose(math.hypot(*quaternion), 1.0, abs_tol=UNIT_TOLERANCE):
            raise Malformed(f"a QTDATA with a quaternion of length {math.hypot(*quaternion):.3g}")
        rotation = Rotation.from_quat(quaternion).as_matrix()
        tools.append(TrackedTool(name, kind, _matrix([*rotation.T.ravel(), x, y, z])))
    return tuple(tools)


def encode_status(status: Status) -> bytes:
    """Encode a STATUS. The text ends with a zero byte: the reference library drops one without it."""
    error = status.error.encode("ascii", "replace")[:LONGEST_NAME_BYTES]
    return _STATUS.pack(status.code, status.sub_code, error) + status.text.encode() + b"\0"


def decode_status(content: bytes) -> Status:
    """Decode a STATUS."""
    if len(content) < _STATUS.size:
        raise Malformed(f"a STATUS of {len(content)} bytes")
    code, sub_code, error = _STATUS.unpack_from(content)
    text = content[_STATUS.size :].rstrip(b"\0").decode("utf-8", "replace")
    return Status(code, text, decode_text(error), sub_code)


def encode_string(text: str) -> bytes:
    """Encode a STRING, cut to what fits."""
    content = text.encode()[:LONGEST_STRING_BYTES].decode("utf-8", "ignore").encode()
    return _STRING.pack(ASCII if text.isascii() else UTF_8, len(content)) + content


def decode_string(content: bytes) -> str:
    """Decode a STRING."""
    if len(content) < _STRING.size:
        raise Malformed(f"a STRING of {len(content)} bytes")
    _, size = _STRING.unpack_from(content)
    text = content[_STRING.size :]
    if size != len(text):
        raise Malformed(f"a STRING of {len(text)} bytes that states {size}")
    return text.decode("utf-8", "replace")


class Mark(NamedTuple):
    """Appearance of a point or a line: group, colour (RGBA, 0 to 255), and the image that it lies in."""

    group: str = ""
    colour: tuple[int, int, int, int] = (255, 255, 255, 255)
    owner: str = ""


def encode_point(name: str, position_mm: Vector3, diameter_mm: float, mark: Mark) -> bytes:
    """Encode a point of a POINT message; the points of a message follow each other."""
    return _POINT.pack(
        *_labels(name, mark),
        *mark.colour,
        *position_mm,
        diameter_mm,
        encode_text(mark.owner, LONGEST_NAME_BYTES),
    )


def encode_line(name: str, entry_mm: Vector3, target_mm: Vector3, diameter_mm: float, mark: Mark) -> bytes:
    """Encode a trajectory of a TRAJ message; the trajectories of a message follow each other."""
    ends = (*entry_mm, *target_mm)
    labels = (*_labels(name, mark), _LINE_WITH_BOTH_ENDS, 0)
    return _LINE.pack(*labels, *mark.colour, *ends, diameter_mm, encode_text(mark.owner, LONGEST_NAME_BYTES))


def encode_image(
    size: tuple[int, int, int],
    pixels: bytes,
    scalar: ScalarType,
    placement: ArrayLike,
    system: CoordinateSystem,
    *,
    components: int = 1,
) -> bytes:
    """Encode an IMAGE. `placement` maps indices (column, row, slice) to mm; the wire has the centre instead.

    Pixels are little-endian, the column fastest.
    """
    matrix = np.asarray(placement, float)
    centre = matrix[:3, 3] + matrix[:3, :3] @ ((np.array(size) - 1) / 2)
    placed = _columns(np.column_stack([matrix[:3, :3], centre]))
    header = (1, components, scalar, _LITTLE_ENDIAN, system)
    return _IMAGE.pack(*header, *size, *placed, 0, 0, 0, *size) + pixels


def encode_command(command: Command) -> bytes:
    """Encode a COMMAND or RTS_COMMAND; the answer names its error in place of the command."""
    text = command.text.encode()
    name = encode_text(command.name, LONGEST_COMMAND_BYTES)
    return _COMMAND.pack(command.number, name, ASCII if text.isascii() else UTF_8, len(text)) + text


def decode_command(content: bytes) -> Command:
    """Decode a COMMAND or RTS_COMMAND."""
    if len(content) < _COMMAND.size:
        raise Malformed(f"a COMMAND of {len(content)} bytes")
    number, name, _, size = _COMMAND.unpack_from(content)
    text = content[_COMMAND.size :]
    if size != len(text):
        raise Malformed(f"a COMMAND of {len(text)} bytes that states {size}")
    return Command(number, decode_text(name), text.decode("utf-8", "replace"))


def encode_subscription(subscription: Subscription) -> bytes:
    """Encode an STT_TDATA or STT_QTDATA."""
    return _START.pack(subscription.interval_ms, encode_text(subscription.frame, LONGEST_FRAME_BYTES))


def decode_subscription(content: bytes) -> Subscription:
    """Decode an STT_TDATA or STT_QTDATA."""
    interval_ms, frame = _unpack(_START, content, "STT_TDATA")
    return Subscription(interval_ms, decode_text(frame))


def encode_capability(kinds: Iterable[str]) -> bytes:
    """Encode a CAPABILITY: the types that the sender knows."""
    return b"".join(encode_text(kind, LONGEST_TYPE_BYTES).ljust(LONGEST_TYPE_BYTES, b"\0") for kind in kinds)


def _columns(matrix: ArrayLike) -> list[float]:
    columns: list[float] = np.asarray(matrix, float)[:3, :4].T.ravel().tolist()
    return columns


def _quaternion(pose: Matrix) -> list[float]:
    scalar_last: list[float] = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    return scalar_last


def _tool_name(tool: TrackedTool) -> bytes:
    return encode_text(tool.name, LONGEST_NAME_BYTES)


def _labels(name: str, mark: Mark) -> tuple[bytes, bytes]:
    return encode_text(name, LONGEST_POINT_NAME_BYTES), encode_text(mark.group, LONGEST_GROUP_BYTES)


def _unpack(layout: struct.Struct, content: bytes, kind: str) -> tuple[Any, ...]:
    if len(content) != layout.size:
        raise Malformed(f"a {kind} of {len(content)} bytes, expected {layout.size}")
    return layout.unpack(content)


def _unpack_tools(layout: struct.Struct, content: bytes, kind: str) -> Iterator[tuple[str, int, list[float]]]:
    if len(content) % layout.size:
        raise Malformed(f"a {kind} of {len(content)} bytes, expected a multiple of {layout.size}")
    for name, tool_kind, _, *numbers in layout.iter_unpack(content):
        yield decode_text(name), tool_kind, numbers


def _matrix(numbers: Sequence[float]) -> Matrix:
    matrix = np.eye(4)
    matrix[:3, :4] = np.reshape(numbers, (4, 3)).T
    if not np.isfinite(matrix).all():
        raise Malformed("a pose with numbers that are not finite")
    return matrix
