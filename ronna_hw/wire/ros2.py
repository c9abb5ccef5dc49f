"""ROS 2 messages as a log holds them: definitions (`ros2msg`) and little-endian CDR.

Lengths are metres and angles radians, as ROS has them (REP 103); rotations come scalar first and are written
x y z w. A time is UTC in nanoseconds.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronna_hw.vectors import Quaternion, Vector3

HEADER_BYTES = b"\0\1\0\0"  # of little-endian CDR; alignment counts from behind it
NS = 1_000_000_000
_SEPARATOR = "=" * 80

TF, JOINTS, POSE = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
IMAGE, LOG, TEXT = "sensor_msgs/msg/CompressedImage", "rcl_interfaces/msg/Log", "std_msgs/msg/String"
MARKERS = "visualization_msgs/msg/MarkerArray"

_PARTS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
    "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
    "builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n"
    "std_msgs/ColorRGBA[] colors\nstring texture_resource\nsensor_msgs/CompressedImage texture\n"
    "visualization_msgs/UVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\n"
    "visualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials",
}
_MESSAGES = {
    TF: "geometry_msgs/TransformStamped[] transforms",
    JOINTS: "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
    POSE: "std_msgs/Header header\ngeometry_msgs/Pose pose",
    IMAGE: _PARTS["sensor_msgs/CompressedImage"],
    LOG: "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\n"
    "string function\nuint32 line",
    TEXT: "string data",
    MARKERS: "visualization_msgs/Marker[] markers",
}


def definition_of(message: str) -> str:
    """Return the definition of a message with those of all its parts, as MCAP wants it."""
    texts, waiting, known = [_MESSAGES[message]], [_MESSAGES[message]], set[str]()
    while waiting:
        for line in waiting.pop().splitlines():
            part = line.split()[0].removesuffix("[]")
            if part in _PARTS and part not in known:
                known.add(part)
                waiting.append(_PARTS[part])
                texts.append(f"{_SEPARATOR}\nMSG: {part}\n{_PARTS[part]}")
    return "\n".join(texts)


class CdrWriter:
    """Writer of one message, field by field."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def put(self, codes: str, *values: float) -> CdrWriter:
        """Append numbers by their struct codes, each aligned to its size."""
        for code, value in zip(codes, values, strict=True):
            self._align(struct.calcsize(code))
            self._bytes += struct.pack(f"<{code}", value)
        return self

    def text(self, text: str) -> CdrWriter:
        """Append a string."""
        encoded = text.encode() + b"\0"
        self.put("I", len(encoded))
        self._bytes += encoded
        return self

    def blob(self, data: bytes) -> CdrWriter:
        """Append a sequence of bytes."""
        self.put("I", len(data))
        self._bytes += data
        return self

    def doubles(self, values: Sequence[float]) -> CdrWriter:
        """Append double-precision numbers without their count."""
        self._align(8)
        self._bytes += struct.pack(f"<{len(values)}d", *values)
        return self

    def header(self, stamp_ns: int, frame: str) -> CdrWriter:
        """Append a `std_msgs/Header`."""
        return self.put("iI", *divmod(stamp_ns, NS)).text(frame)

    def pose(self, position_m: Vector3, rotation: Quaternion) -> CdrWriter:
        """Append a position and a rotation."""
        w, x, y, z = rotation
        return self.doubles((*position_m, x, y, z, w))

    @property
    def message(self) -> bytes:
        return HEADER_BYTES + bytes(self._bytes)

    def _align(self, size: int) -> None:
        self._bytes += bytes(-len(self._bytes) % size)


class Placed(NamedTuple):
    """Pose of a child frame in its parent."""

    parent: str
    child: str
    position_m: Vector3
    rotation: Quaternion


def encode_transforms(stamp_ns: int, placed: Sequence[Placed]) -> bytes:
    """Encode a `TFMessage`."""
    writer = CdrWriter().put("I", len(placed))
    for one in placed:
        writer.header(stamp_ns, one.parent).text(one.child).pose(one.position_m, one.rotation)
    return writer.message


def encode_pose(stamp_ns: int, placed: Placed) -> bytes:
    """Encode a `PoseStamped`: the child's pose in the frame of its parent."""
    return CdrWriter().header(stamp_ns, placed.parent).pose(placed.position_m, placed.rotation).message


def encode_joints(
    stamps_ns: NDArray[np.int64], names: Sequence[str], positions: NDArray[np.float64]
) -> list[bytes]:
    """Encode a `JointState` for each row of positions (n, axes), all at once: only their numbers differ."""
    writer = CdrWriter().header(0, "").put("I", len(names))
    for name in names:
        writer.text(name)
    start = len(writer.put("I", len(names)).doubles(()).message)
    template = np.frombuffer(writer.doubles([0.0] * len(names)).put("II", 0, 0).message, np.uint8)
    rows = np.tile(template, (len(positions), 1))
    stamp = np.empty((len(positions), 2), "<u4")
    stamp[:, 0], stamp[:, 1] = stamps_ns // NS, stamps_ns % NS
    begin = len(HEADER_BYTES)
    rows[:, begin : begin + 8] = stamp.view(np.uint8)
    numbers = np.ascontiguousarray(positions, "<f8").view(np.uint8)
    rows[:, start : start + numbers.shape[1]] = numbers
    return [row.tobytes() for row in rows]


def encode_image(stamp_ns: int, frame: str, jpeg: bytes) -> bytes:
    """Encode a `CompressedImage` with a JPEG."""
    return CdrWriter().header(stamp_ns, frame).text("jpeg").blob(jpeg).message


def encode_log(stamp_ns: int, level: int, name: str, text: str) -> bytes:
    """Encode a line of `/rosout`; levels are 10 debug, 20 info, 30 warning, 40 error, 50 fatal."""
    writer = CdrWriter().put("iI", *divmod(stamp_ns, NS)).put("B", level).text(name).text(text)
    return writer.text("").text("").put("I", 0).message


def encode_text(text: str) -> bytes:
    """Encode a `String`."""
    return CdrWriter().text(text).message


class Marker(NamedTuple):
    """Sphere at a point, or line along points, in one frame."""

    frame: str
    group: str
    points_m: Sequence[Vector3]
    size_m: float
    colour: tuple[float, float, float, float]

    def put(self, writer: CdrWriter, stamp_ns: int, number: int) -> None:
        """Append it as a `visualization_msgs/Marker`."""
        is_line = len(self.points_m) > 1
        at = (0.0, 0.0, 0.0) if is_line else self.points_m[0]
        sphere, line_strip, add = 2, 4, 0
        writer.header(stamp_ns, self.frame).text(self.group)
        writer.put("iii", number, line_strip if is_line else sphere, add)
        writer.pose(at, (1.0, 0.0, 0.0, 0.0)).doubles((self.size_m,) * 3).put("ffff", *self.colour)
        writer.put("iI?", 0, 0, False).put("I", len(self.points_m) if is_line else 0)
        for point_m in self.points_m if is_line else ():
            writer.doubles(point_m)
        writer.put("I", 0).text("").header(0, "").text("").blob(b"").put(
            "I", 0
        )  # colours, texture, coordinates
        writer.text("").text("").text("").blob(b"").put("?", False)  # text and mesh


def encode_markers(stamp_ns: int, markers: Sequence[Marker]) -> bytes:
    """Encode a `MarkerArray`."""
    writer = CdrWriter().put("I", len(markers))
    for number, marker in enumerate(markers):
        marker.put(writer, stamp_ns, number)
    return writer.message


class CdrReader:
    """Reader of one message, field by field. Raises ValueError for a message that ends too early."""

    def __init__(self, message: bytes) -> None:
        if message[: len(HEADER_BYTES)] != HEADER_BYTES:
            raise ValueError("not little-endian CDR")
        self._bytes = message[len(HEADER_BYTES) :]
        self._at = 0

    def number(self, code: str) -> int:
        """Read an integer by its struct code."""
        size = struct.calcsize(code)
        self._at += -self._at % size
        found: int = struct.unpack(f"<{code}", self._take(size))[0]
        return found

    def text(self) -> str:
        """Read a string."""
        return self._take(self.number("I")).removesuffix(b"\0").decode()

    def blob(self) -> bytes:
        """Read a sequence of bytes."""
        return self._take(self.number("I"))

    def doubles(self, count: int | None = None) -> tuple[float, ...]:
        """Read double-precision numbers: so many, or a sequence with its count."""
        count = self.number("I") if count is None else count
        if count:
            self._at += -self._at % 8
        return struct.unpack(f"<{count}d", self._take(8 * count))

    def header(self) -> str:
        """Read a `std_msgs/Header` and return its frame."""
        self.number("i")
        self.number("I")
        return self.text()

    def pose(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Read a position and a rotation, scalar first."""
        px, py, pz, x, y, z, w = self.doubles(7)
        return (px, py, pz), (w, x, y, z)

    def _take(self, size: int) -> bytes:
        part = self._bytes[self._at : self._at + size]
        if len(part) != size:
            raise ValueError("the message ends too early")
        self._at += size
        return part
