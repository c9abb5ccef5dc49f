"""Values of a running case as OpenIGTLink messages: what each record changes, and the latest of all."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from procedures.live.openigtlink.names import (
    CAMERA_IMAGES,
    CT_IMAGE,
    ENTRIES,
    PLAN,
    RUN_STATE,
    SERVER,
    SPHERES,
    TARGETS,
    as_ras,
    check_names,
    device_name,
    frame_word,
)
from procedures.live.openigtlink.outgoing import Outgoing
from procedures.live.openigtlink.poses import TRANSFORM, Pose, Poses
from procedures.live.records import (
    Began,
    CameraPicture,
    DeviceStatus,
    Fiducial,
    Fiducials,
    FramePose,
    LiveRecord,
    PlannedLines,
    RunState,
)
from ronna_hw.devices.lifecycle import RUNNING, Lifecycle
from ronna_hw.frames import Frame
from ronna_hw.wire.openigtlink_contents import (
    LONGEST_GROUP_BYTES,
    LONGEST_POINT_NAME_BYTES,
    TRACKING_6D,
    Mark,
    Status,
    StatusCode,
    TrackedTool,
    encode_line,
    encode_point,
    encode_quaternion_tracking,
    encode_status,
    encode_string,
    encode_tracking,
)

NS_PER_S: Final = 1e9
GREEN, GREY, BLUE, RED = (0, 200, 0, 255), (128, 128, 128, 255), (0, 96, 255, 255), (220, 0, 0, 255)
TRACKING_ENCODERS: Final = {"TDATA": encode_tracking, "QTDATA": encode_quaternion_tracking}


class LinkValues:
    """Latest values of a running case. Without `Began` there are no stamps, so that is the first record."""

    def __init__(self) -> None:
        """Raise LIV-010 at the start if a frame's name does not fit."""
        check_names()
        self.latest: dict[tuple[str, str], Outgoing] = {}
        self.pictures: dict[str, tuple[CameraPicture, int]] = {}  # by the name of the image, with its stamp
        self._poses = Poses()
        self._shown: dict[str, Pose] = {}  # by the name of its transform
        self._epoch_ns = 0

    def take(self, record: LiveRecord) -> list[Outgoing]:
        """Take a record and return the messages that follow. Raises LIV-010 for a name that does not fit."""
        changed = list(self._read(record))
        self.latest.update((one.key, one) for one in changed)
        return changed

    @property
    def standing(self) -> Iterator[Outgoing]:
        """Messages that stand until they change. Of poses, not those of the tracker: it sees no rest."""
        for one in self.latest.values():
            if one.kind != TRANSFORM or self._shown[one.name].parent != Frame.TRACKER:
                yield one

    @property
    def repeated(self) -> Iterator[Outgoing]:
        """States and fixed poses: what does not come again looks stale in Slicer."""
        for one in self.latest.values():
            if one.kind == "STATUS" or (one.kind == TRANSFORM and self._shown[one.name].is_fixed):
                yield one

    def tracking(self, kind: str, frame: str) -> Outgoing:
        """Return all valid poses as one TDATA or QTDATA, with the time of the oldest that moves.

        With a `frame` only those in it, named by their child alone: PLUS adds the frame again.
        """
        shown = [
            (one, self._shown[one.name])
            for one in self.latest.values()
            if one.kind == TRANSFORM
            and not one.needs_metadata
            and (not frame or one.name.endswith(f"To{frame}"))
        ]
        tools = [
            TrackedTool(frame_word(pose.child) if frame else one.name, TRACKING_6D, pose.sent_matrix)
            for one, pose in shown
        ]
        moving = [one.stamp_ns for one, pose in shown if not pose.is_fixed]
        stamp_ns = min(moving or [one.stamp_ns for one, _ in shown], default=0)  # none is older than it says
        return Outgoing(kind, SERVER, TRACKING_ENCODERS[kind](tools), stamp_ns)

    def _read(self, record: LiveRecord) -> Iterator[Outgoing]:
        stamp_ns = self._epoch_ns + round(record.theatre_time_s * NS_PER_S)
        match record:
            case Began():
                self._epoch_ns = record.epoch_ns
            case FramePose():
                for pose in self._poses.take(record, stamp_ns):
                    transform = pose.outgoing()
                    self._shown[transform.name] = pose
                    yield transform
            case DeviceStatus():
                yield _describe_device(record, stamp_ns)
            case RunState():
                yield _describe_run(record, stamp_ns)
            case Fiducials():
                yield _show_spheres(record, stamp_ns)
            case PlannedLines():
                yield from _show_plan(record, stamp_ns)
            case CameraPicture():
                self.pictures[CAMERA_IMAGES[record.side]] = (record, stamp_ns)


def _describe_device(record: DeviceStatus, stamp_ns: int) -> Outgoing:
    if record.state == Lifecycle.FAULT or record.code:
        code = StatusCode.HARDWARE_FAILURE
    else:
        code = StatusCode.OK if record.state in RUNNING else StatusCode.NOT_READY
    words = ": ".join(part for part in (record.state, record.text) if part)
    text = f"{words.rstrip('.')}. {record.advice}" if record.advice else words
    return Outgoing(
        "STATUS", device_name(record.device), encode_status(Status(code, text, record.code)), stamp_ns
    )


def _describe_run(record: RunState, stamp_ns: int) -> Outgoing:
    text = ": ".join(part for part in (record.state, record.step, record.reason) if part)
    fields = {"run": record.run, "state": record.state, "step": record.step, "reason": record.reason}
    return Outgoing("STRING", RUN_STATE, encode_string(text), stamp_ns, fields)


def _show_spheres(record: Fiducials, stamp_ns: int) -> Outgoing:
    content, metadata = b"", {}
    for sphere in record.spheres:
        name = _fit(sphere.name, LONGEST_POINT_NAME_BYTES)
        colour = GREEN if sphere.is_used else GREY
        mark = Mark(_fit(_describe_sphere(sphere), LONGEST_GROUP_BYTES), colour, CT_IMAGE)
        content += encode_point(name, as_ras(sphere.position_mm), sphere.diameter_mm, mark)
        if sphere.residual_mm is not None:
            metadata[f"{name}.residual_mm"] = f"{sphere.residual_mm:.4f}"
        if sphere.is_used is not None:
            metadata[f"{name}.used"] = str(int(sphere.is_used))
    return Outgoing("POINT", SPHERES, content, stamp_ns, metadata)


def _describe_sphere(sphere: Fiducial) -> str:
    """Return a sphere's group, from which readers without metadata learn how it fits."""
    if sphere.is_used is None:
        return "sphere"
    used = "used" if sphere.is_used else "not used"
    return used if sphere.residual_mm is None else f"{used}, residual {sphere.residual_mm:.2f} mm"


def _show_plan(record: PlannedLines, stamp_ns: int) -> Iterator[Outgoing]:
    """Yield the plan as trajectories, and their ends as points for readers without TRAJ, as Slicer."""
    lines = [
        (_fit(one.name, LONGEST_POINT_NAME_BYTES), as_ras(one.entry_mm), as_ras(one.target_mm))
        for one in record.lines
    ]
    entry, target = Mark("entry", BLUE, CT_IMAGE), Mark("target", RED, CT_IMAGE)
    planned = b"".join(
        encode_line(name, begin, end, 0.0, Mark("planned", BLUE, CT_IMAGE)) for name, begin, end in lines
    )
    yield Outgoing("TRAJ", PLAN, planned, stamp_ns)
    yield Outgoing(
        "POINT", TARGETS, b"".join(encode_point(name, end, 0.0, target) for name, _, end in lines), stamp_ns
    )
    yield Outgoing(
        "POINT",
        ENTRIES,
        b"".join(encode_point(name, begin, 0.0, entry) for name, begin, _ in lines),
        stamp_ns,
    )


def _fit(text: str, longest_bytes: int) -> str:
    return text.encode("ascii", "replace")[:longest_bytes].decode()
