"""Encoding of device answers: recorded calls, answers as plain JSON, and packed pixels.

Pixels are coded without loss, small and cheap: each row as differences, entropy-coded. The noise of a camera
leaves little for a search for repetitions, so there is none, and coding takes milliseconds. For wide pixels
the low and the high bytes are coded separately.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.bounded_input import inflate
from ronna_hw.devices.axis_loads import AxisLoads
from ronna_hw.devices.contact import Inserted
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.devices.readings import ArmReading, LinkStatistics, StereoReading, ToolIdentity, TrackerFrame
from ronna_hw.devices.robot import OperatingMode

# By name, over all kinds of devices. With `None`, only whether the call raised is recorded.
ANSWERS: dict[str, Any] = {
    "connect": Identity,
    "read_frame": TrackerFrame,
    "grab_pair": StereoReading,
    "read_state": ArmReading,
    "read_tool_identity": ToolIdentity,
    "read_loads": AxisLoads,
    "move": ArmReading,
    "insert": Inserted,
    "preview": PathPreview,
    "limits": MotionLimits,
    "link_statistics": LinkStatistics,
    **dict.fromkeys(("configure", "activate", "deactivate", "resume"), None),
    **dict.fromkeys(("surround", "set_areas", "set_exposure", "scale_exposure", "confirm_start"), None),
    "set_projector": None,
}
# Calls of earlier tapes, by their present names.
RENAMED = {"move_joints": "move", "move_linear": "move"}
# Properties that may change on their own; each access is an answer.
RECORDED_PROPERTIES: dict[str, Any] = {"to_confirm": str | None}
# Properties that a device knows after one of the calls below; recorded with its answer.
PROPERTIES: dict[str, Any] = {
    "serials": tuple[str, str],
    "notices": tuple[str, ...],
    "operating_mode": OperatingMode,
    "stated_calibration": tuple[float, ...],
}
IDENTIFYING_CALLS = ("connect", "configure")


@runtime_checkable
class RecordsCalls(Protocol):
    """Device with additional calls to record and replay, each with the type of its answer."""

    @property
    def recorded_calls(self) -> Mapping[str, Any]: ...


@runtime_checkable
class StatesCalibration(Protocol):
    """Arm whose controller states its factory calibration once connected; a replay adopts what was stated."""

    @property
    def stated_calibration(self) -> tuple[float, ...]: ...

    def adopt_calibration(self, stated: tuple[float, ...]) -> None: ...


def list_recorded_calls(device: object) -> Mapping[str, Any]:
    """List the recorded calls of a device, with the type of each answer."""
    return {**device.recorded_calls, **ANSWERS} if isinstance(device, RecordsCalls) else ANSWERS


PIXELS = "kept pixels"  # the key of a reference to pixels stored elsewhere
PutPixels = Callable[[Any], dict[str, Any]]
GetPixels = Callable[[dict[str, Any]], Any]


def as_plain(value: Any, put: PutPixels) -> Any:
    """Convert a value to plain JSON form; `put` stores pixel arrays and returns a reference.

    Raises ValueError or TypeError for values without such a form.
    """

    def convert_other(part: Any) -> Any:
        if isinstance(part, np.ndarray):
            return {PIXELS: put(part)}
        if isinstance(part, np.generic):
            return part.item()
        raise TypeError(f"{type(part).__name__} has no plain form")

    return to_jsonable_python(value, fallback=convert_other)


def as_recorded(kind: Any, value: Any, get: GetPixels) -> Any:
    """Decode a value of a declared type. Raises ValueError, KeyError or TypeError for invalid data."""
    return _adapter(kind).validate_python(_with_pixels(value, get))


def _with_pixels(value: Any, get: GetPixels) -> Any:
    if isinstance(value, dict):
        if PIXELS in value:
            return get(value[PIXELS])
        return {name: _with_pixels(part, get) for name, part in value.items()}
    return [_with_pixels(part, get) for part in value] if isinstance(value, list) else value


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    adapter = TypeAdapter(kind)
    # Readings import NumPy for their annotations only; they are complete with these names.
    adapter.rebuild(raise_errors=False, _types_namespace={"np": np, "NDArray": NDArray})
    return adapter


Pixels = NDArray[np.uint8] | NDArray[np.uint16]
TYPES: dict[str, type[np.uint8 | np.uint16]] = {"uint8": np.uint8, "uint16": np.uint16}
LARGEST_BYTES = 50_000_000  # ten times a full sensor of ours
CENTRE = 0x80  # small differences of either sign around it: their high byte is then almost constant


def pack_pixels(pixels: Pixels) -> bytes:
    """Pack a 2-D array with 8 or 16 bits per pixel."""
    rows = pixels.copy()
    rows[:, 1:] -= pixels[:, :-1]  # wraps around, and back again
    rows += rows.dtype.type(CENTRE)
    planes = rows.view(np.uint8).reshape(-1, rows.itemsize)
    coder = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_HUFFMAN_ONLY)
    coded = [coder.compress(planes[:, byte].tobytes()) for byte in range(rows.itemsize)]
    return b"".join(coded) + coder.flush()


def unpack_pixels(packed: bytes, shape: tuple[int, int], kind: str) -> Pixels:
    """Unpack a read-only array. Raises ValueError for invalid data."""
    if kind not in TYPES:
        raise ValueError(f"{kind} is not a pixel type")
    wanted = np.dtype(TYPES[kind])
    raw = np.frombuffer(inflate(packed, LARGEST_BYTES), dtype=np.uint8)
    planes = raw.reshape(wanted.itemsize, *shape)
    rows = np.moveaxis(planes, 0, -1).copy(order="C").view(wanted).reshape(shape)
    rows -= rows.dtype.type(CENTRE)
    pixels: Pixels = np.cumsum(rows, axis=1, dtype=wanted)
    pixels.flags.writeable = False
    return pixels
