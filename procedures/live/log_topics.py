"""Topics of the log of a run, and its entries as their messages."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from procedures.live.log_entries import ArmDrawing, JointCycles, JournalEntry, LogEntry, SaidLine
from procedures.live.records import (
    Began,
    CameraPicture,
    DeviceStatus,
    Fiducials,
    FramePose,
    PlannedLines,
    RunState,
)
from ronna_hw.arm import urdf
from ronna_hw.devices.readings import Validity
from ronna_hw.frames import Frame
from ronna_hw.roles import MASTER
from ronna_hw.vectors import Vector3
from ronna_hw.wire import ros2

TF, TF_STATIC = "/tf", "/tf_static"
MEASURED, SET_POINTS, POSES = "measured_js", "setpoint_js", "measured_cp"
PICTURE = "/camera_{side}/image/compressed"
SAID, JOURNAL, STATE, SPHERES, PLAN = "/rosout", "/journal", "/operating_state", "/spheres", "/plan"
DRAWING = "/robot_description"
CASE = "case"  # who says it
M_PER_MM = 1e-3
LINE_M = 0.001  # thickness of a planned line as drawn
GREEN, RED, GREY, BLUE = (
    (0.2, 0.8, 0.2, 1.0),
    (0.9, 0.2, 0.2, 1.0),
    (0.6, 0.6, 0.6, 1.0),
    (0.2, 0.4, 0.9, 1.0),
)


class Topic(NamedTuple):
    """Topic and the type of its messages."""

    name: str
    message: str


class LogMessage(NamedTuple):
    """Encoded message."""

    topic: Topic
    stamp_ns: int  # UTC
    data: bytes


class LogMessages:
    """Encoder of entries. `without_names` replaces names that may identify the patient."""

    def __init__(self, began: Began, without_names: Callable[[str], str]) -> None:
        self._epoch_ns = began.epoch_ns
        self._without_names = without_names

    def of(self, entry: LogEntry) -> Iterator[LogMessage]:
        """Yield the messages of an entry; a pose that is not usable has none."""
        if isinstance(entry, JointCycles):
            yield from self._joints(entry)
            return
        stamp_ns = self._epoch_ns + round(entry.theatre_time_s * ros2.NS)
        for topic, data in self._encode(entry, stamp_ns):
            yield LogMessage(topic, stamp_ns, data)

    def _encode(self, entry: LogEntry, stamp_ns: int) -> Iterator[tuple[Topic, bytes]]:
        match entry:
            case FramePose():
                yield from _encode_pose(entry, stamp_ns)
            case CameraPicture():
                topic = Topic(PICTURE.format(side=entry.side), ros2.IMAGE)
                frame = f"camera_{entry.side}"
                yield topic, ros2.encode_image(stamp_ns, frame, base64.b64decode(entry.jpeg))
            case Fiducials():
                yield Topic(SPHERES, ros2.MARKERS), ros2.encode_markers(stamp_ns, _spheres(entry))
            case PlannedLines():
                yield Topic(PLAN, ros2.MARKERS), ros2.encode_markers(stamp_ns, _lines(entry))
            case RunState() | DeviceStatus():
                plain = entry.model_dump(mode="json", exclude={"theatre_time_s", "kind"})
                yield Topic(STATE, ros2.TEXT), ros2.encode_text(self._as_json(plain))
            case JournalEntry():
                yield Topic(JOURNAL, ros2.TEXT), ros2.encode_text(self._as_json(entry.fields))
            case ArmDrawing():
                yield Topic(DRAWING, ros2.TEXT), ros2.encode_text(entry.urdf)
                base = ros2.Placed(Frame.ROBOT, urdf.BASE, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
                yield Topic(TF_STATIC, ros2.TF), ros2.encode_transforms(stamp_ns, (base,))
            case SaidLine():
                text = self._without_names(entry.text)
                yield Topic(SAID, ros2.LOG), ros2.encode_log(stamp_ns, entry.level, CASE, text)
            case _:
                pass

    def _as_json(self, fields: Mapping[str, object]) -> str:
        """Return fields as JSON, without names in their texts; numbers stay as they are."""
        return json.dumps(
            {
                name: self._without_names(value) if isinstance(value, str) else value
                for name, value in fields.items()
            }
        )

    def _joints(self, cycles: JointCycles) -> Iterator[LogMessage]:
        stamps_ns = self._epoch_ns + np.rint(cycles.times_s * ros2.NS).astype(np.int64)
        for name, rows in ((MEASURED, cycles.measured_rad), (SET_POINTS, cycles.commanded_rad)):
            if rows is not None:
                topic = Topic(arm_topic(cycles.arm, name), ros2.JOINTS)
                encoded = ros2.encode_joints(stamps_ns, cycles.axes, rows)
                yield from map(LogMessage, [topic] * len(encoded), stamps_ns.tolist(), encoded)


def arm_topic(arm: str, name: str) -> str:
    """Return the topic of an arm; those of the master need no prefix."""
    return f"/{name}" if arm == MASTER else f"/{arm}/{name}"


def _encode_pose(pose: FramePose, stamp_ns: int) -> Iterator[tuple[Topic, bytes]]:
    if pose.rotation is None or pose.translation_mm is None or pose.validity is not Validity.OK:
        return
    placed = ros2.Placed(pose.parent, pose.child, _metres(pose.translation_mm), pose.rotation)
    topic = Topic(TF_STATIC if pose.is_fixed else TF, ros2.TF)
    yield topic, ros2.encode_transforms(stamp_ns, (placed,))
    if pose.child == Frame.FLANGE:
        yield Topic(f"/{POSES}", ros2.POSE), ros2.encode_pose(stamp_ns, placed)


def _spheres(found: Fiducials) -> list[ros2.Marker]:
    colours = {True: GREEN, False: RED, None: GREY}
    return [
        ros2.Marker(
            Frame.CT,
            "spheres",
            (_metres(one.position_mm),),
            one.diameter_mm * M_PER_MM,
            colours[one.is_used],
        )
        for one in found.spheres
    ]


def _lines(plan: PlannedLines) -> list[ros2.Marker]:
    return [
        ros2.Marker(Frame.CT, "plan", (_metres(one.entry_mm), _metres(one.target_mm)), LINE_M, BLUE)
        for one in plan.lines
    ]


def _metres(place_mm: Vector3) -> Vector3:
    x, y, z = place_mm
    return x * M_PER_MM, y * M_PER_MM, z * M_PER_MM


def without_identity(line: Mapping[str, object]) -> dict[str, object]:
    """Return those fields of a journal line that say neither who nor, in free words, what."""
    return {name: line[name] for name in JOURNAL_FIELDS if name in line}


JOURNAL_FIELDS = ("sequence", "entry", "theatre_time_s", "step", "record", "code", "outcome", "moves")
