"""Readings of the tracker as poses of a running case."""

from __future__ import annotations

from pathlib import Path

from procedures.engine.events import EventStream
from procedures.live.feed import LiveFeed
from procedures.live.records import FramePose
from ronna_hw.clock import HostClock
from ronna_hw.devices.readings import Stamp, ToolReading, TrackerFrame, Validity

TURN, PLACE_MM = (1.0, 0.0, 0.0, 0.0), (1.0, 2.0, -1500.0)
SEEN = ToolReading("patient", Validity.OK, TURN, PLACE_MM, 0.1)
HIDDEN = ToolReading("patient", Validity.MISSING, None, None, None)


def _poses(feed: LiveFeed, *tools: ToolReading, validity: Validity = Validity.OK) -> list[FramePose]:
    stamp = Stamp(1, 60, theatre_time_s=2.0, measured_s=1.98)
    return list(feed._tool_poses(TrackerFrame(stamp, validity, tools, ())))


def test_a_tool_has_the_pose_and_the_time_of_its_measurement(tmp_path: Path) -> None:
    (pose,) = _poses(LiveFeed(tmp_path, HostClock(), EventStream()), SEEN)
    assert (pose.parent, pose.child, pose.theatre_time_s) == ("tracker", "patient", 1.98)
    assert (pose.rotation, pose.translation_mm, pose.validity) == (TURN, PLACE_MM, Validity.OK)


def test_a_tool_that_is_hidden_or_in_a_damaged_frame_has_no_pose_and_says_why(tmp_path: Path) -> None:
    feed = LiveFeed(tmp_path, HostClock(), EventStream())
    _poses(feed, SEEN)
    for lost in (_poses(feed, HIDDEN), _poses(feed), _poses(feed, validity=Validity.CORRUPT)):
        (pose,) = lost
        assert pose.rotation is None
        assert pose.translation_mm is None
    assert pose.validity is Validity.CORRUPT
