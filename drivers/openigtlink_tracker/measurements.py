"""From OpenIGTLink messages to measurements of all tools at one moment.

A TDATA message holds a whole measurement. Of TRANSFORM messages, one per tool, those with the same time stamp
belong together. Servers leave out what they do not see, so a tool's absence says that it is missing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from drivers.openigtlink_tracker.errors import SharedName
from drivers.openigtlink_tracker.options import OpenIGTLinkOptions
from ronna_hw.devices.readings import ToolReading, Validity
from ronna_hw.vectors import vector3
from ronna_hw.wire.openigtlink import LONGEST_NAME_BYTES, Message
from ronna_hw.wire.openigtlink_contents import TRACKING_6D, Matrix, decode_tracking, decode_transform

ROTATION_TOLERANCE: Final = 1e-3  # of a rotation matrix in single precision, as some peers round it
MOST_NAMES: Final = 100  # of a server's transforms that are remembered for a message to the operator
CLOCK_WINDOW_S: Final = 60.0  # long enough for a message with hardly any delay; a quartz drifts by 6 ms
NANOSECONDS: Final = 1e9
FULL_NAME, STATUS, IS_VALID = "IGTL_DEVICE_NAME", "TransformStatus", "TransformValid"  # metadata of PLUS
_VALIDITY: Final = {
    "OK": Validity.OK,
    "OUT_OF_VOLUME": Validity.OUT_OF_VOLUME,
    "INVALID": Validity.CORRUPT,
}  # of TransformStatus; every other word says that the tool was not seen


class Sample(NamedTuple):
    """Pose of a tool as sent, and whether it may be used."""

    validity: Validity
    pose: Matrix


@dataclass
class Measurement:
    """Poses of the tools that the server sent for one moment, by the full names of their transforms."""

    stamp_ns: int
    arrived_s: float  # theatre time of the first part
    began_s: float  # host time of the first part
    samples: dict[str, Sample] = field(default_factory=dict)
    number: int = 0  # counted from 1 when it is complete


class Assembler:
    """Assembles measurements from a server's messages; host times decide when one is complete."""

    def __init__(self, options: OpenIGTLinkOptions, now_s: float) -> None:
        self._options = options
        self.last_s = now_s  # host time at which tools were last sent, or found to be missing
        self._expected = {
            name[:LONGEST_NAME_BYTES]: name for name in options.sent_names.values()
        }  # by the name as a server may have cut it
        self._in_tracking_data = False
        self._open: Measurement | None = None
        self.newest: Measurement | None = None
        self.count = 0
        self.names: set[str] = set()  # of all transforms that the server sends

    def add(self, message: Message, arrived_s: float, now_s: float) -> None:
        """Take a TDATA or TRANSFORM. Raises Malformed, and IGT-008 for two poses of one name and moment."""
        if message.kind == "TDATA":
            self._in_tracking_data = True
            whole = Measurement(message.stamp_ns, arrived_s, now_s)
            for tool in decode_tracking(message.content):
                state = Validity.OK if tool.kind == TRACKING_6D else Validity.CORRUPT  # a part of a pose
                self._put(whole, tool.name, Sample(state, tool.pose))
            self._finish(whole)
            return
        pose = decode_transform(message.content)
        if self._in_tracking_data:  # the same poses again
            return
        name = self._note_name(message.metadata.get(FULL_NAME, message.name))
        if name is None:
            return
        part = self._open
        if part is not None and self._begins_another(part, name, message.stamp_ns):
            self._finish(part)
            part = None
        if part is None:
            part = self._open = Measurement(message.stamp_ns, arrived_s, now_s)
            self.last_s = now_s
        self._put(part, name, Sample(_read_validity(message.metadata), pose))
        if len(part.samples) == len(self._expected):
            self._finish(part)

    def close_overdue(self, now_s: float) -> None:
        """Complete a measurement whose other tools have not come in time."""
        if self._open is not None and now_s - self._open.began_s >= self._options.hidden_after_s:
            self._finish(self._open)

    def add_empty(self, arrived_s: float, now_s: float) -> None:
        """Add a measurement in which the server saw none of the tools."""
        self._finish(Measurement(0, arrived_s, now_s))

    def _begins_another(self, part: Measurement, name: str, stamp_ns: int) -> bool:
        is_again = name in part.samples and (stamp_ns == 0 or stamp_ns != part.stamp_ns)
        return is_again or abs(stamp_ns - part.stamp_ns) > self._options.together_s * NANOSECONDS

    def _put(self, part: Measurement, name: str, sample: Sample) -> None:
        full = self._note_name(name)
        if full is None:
            return
        before = part.samples.setdefault(full, sample)
        if not np.array_equal(before.pose, sample.pose):
            raise SharedName(f"two poses of one moment are called {full}", got=_show_places(before, sample))

    def _note_name(self, name: str) -> str | None:
        """Return the full name of an expected transform, None for any other; remember what is sent."""
        if len(self.names) < MOST_NAMES:
            self.names.add(name)
        full = self._expected.get(name[:LONGEST_NAME_BYTES])
        return full if full is not None and name in (full, full[:LONGEST_NAME_BYTES]) else None

    def _finish(self, measurement: Measurement) -> None:
        self._open = None
        self.last_s = max(self.last_s, measurement.began_s)
        self.count += 1
        measurement.number = self.count
        self.newest = measurement


def _read_validity(metadata: Mapping[str, str]) -> Validity:
    status = metadata.get(STATUS)
    if status is not None:
        return _VALIDITY.get(status, Validity.MISSING)
    is_valid = metadata.get(IS_VALID, "1").lower() in ("1", "true")
    return Validity.OK if is_valid else Validity.MISSING


def _show_places(*samples: Sample) -> str:
    return " and ".join(
        "x {:.2f} y {:.2f} z {:.2f} mm".format(*sample.pose[:3, 3].tolist()) for sample in samples
    )


class ToolReader:
    """Turns the samples of one tool into readings, and notices a pose that has frozen."""

    def __init__(self, tool: str, frozen_after_s: float) -> None:
        self._tool, self._frozen_after_s = tool, frozen_after_s
        self._last: Matrix | None = None
        self._since_s = 0.0  # host time

    def read(self, sample: Sample | None, now_s: float) -> ToolReading:
        """Return the reading of a measurement; a pose that cannot be one is CORRUPT."""
        if sample is None:
            return self._without_pose(Validity.MISSING)
        if self._last is None or not np.array_equal(sample.pose, self._last):
            self._last, self._since_s = sample.pose, now_s
        if sample.validity is not Validity.OK:
            return self._without_pose(sample.validity)
        if np.array_equal(sample.pose, np.eye(4)) or now_s - self._since_s > self._frozen_after_s:
            return self._without_pose(Validity.MISSING)  # as servers send a tool that they do not see
        rotation = sample.pose[:3, :3]
        is_rotation = np.allclose(rotation.T @ rotation, np.eye(3), rtol=0.0, atol=ROTATION_TOLERANCE)
        if not is_rotation or np.linalg.det(rotation) < 0:
            return self._without_pose(Validity.CORRUPT)
        from scipy.spatial.transform import Rotation

        w, x, y, z = Rotation.from_matrix(rotation).as_quat(scalar_first=True).tolist()
        return ToolReading(self._tool, Validity.OK, (w, x, y, z), vector3(sample.pose[:3, 3].tolist()), None)

    def _without_pose(self, validity: Validity) -> ToolReading:
        return ToolReading(self._tool, validity, None, None, None)


class StampClock:
    """Places a server's time stamps in theatre time, by the least delayed message of the last minute.

    The delay that all messages have in common cannot be told from the difference of the clocks.
    """

    def __init__(self) -> None:
        self._least: deque[tuple[float, float]] = deque()  # arrival and difference, both rising
        self._first_ns: int | None = None  # seconds since 1970 are too large for a float's last digits

    def place(self, stamp_ns: int, arrived_s: float) -> float:
        """Return the theatre time of a stamp, given the theatre time of its arrival."""
        if self._first_ns is None:
            self._first_ns = stamp_ns
        stamp_s = (stamp_ns - self._first_ns) / NANOSECONDS
        while self._least and self._least[0][0] < arrived_s - CLOCK_WINDOW_S:
            self._least.popleft()
        difference_s = arrived_s - stamp_s
        while self._least and self._least[-1][1] >= difference_s:
            self._least.pop()
        self._least.append((arrived_s, difference_s))
        return min(arrived_s, stamp_s + self._least[0][1])
