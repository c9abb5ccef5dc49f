"""Tracking replies as readings: poses, validities, strays, and replies that are refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from coded_errors import raises
from polaris_unit_in_process import bring_up

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.errors import MalformedReply
from ronna_hw.devices import new_frames
from ronna_hw.devices.errors import NO_POSE, UnknownTool
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import Validity
from ronna_hw.devices.strays import average_strays
from ronna_hw.errors import EXIT_USAGE
from ronna_hw.frames import FRAME_MISMATCH, Frame

Make = Callable[..., PolarisTracker]


@pytest.mark.parametrize("reply", ["BX", "TX"])
def test_a_frame_holds_pose_frame_number_and_theatre_time(make_tracker: Make, clock: Any, reply: str) -> None:
    device = bring_up(make_tracker(reply=reply))
    clock.time_s = 12.5
    frame = device.read_frame()
    assert (frame.stamp.sequence, frame.stamp.device_clock, frame.stamp.theatre_time_s) == (1, 0, 12.5)
    assert frame.validity is Validity.OK
    tool = frame.tool("robot_frame")
    assert tool.validity is Validity.OK
    assert tool.rotation == (1.0, 0.0, 0.0, 0.0)
    assert tool.position_mm == pytest.approx((10.0, -20.0, -1500.0))
    assert tool.fit_error_mm == pytest.approx(0.125)
    assert tool.markers_used == (True,) * 4
    assert device.read_frame().stamp.device_clock == 1
    assert device.statistics.frames == 2


def test_a_unit_without_binary_replies_is_read_with_tx(make_tracker: Make, unit: Any) -> None:
    unit.answers_to["BX"] = "ERROR01"
    device = bring_up(make_tracker())
    device.read_frame()
    device.read_frame()
    assert unit.commands.count("BX:1803") == 2  # the first refusal may have been noise
    assert unit.commands.count("TX:1803") == 2


@pytest.mark.parametrize("reply", ["BX", "TX"])
def test_a_pose_says_which_markers_it_was_fitted_to(make_tracker: Make, unit: Any, reply: str) -> None:
    unit.marker_digits = "3303"
    tool = bring_up(make_tracker(reply=reply)).read_frame().tool("robot_frame")
    assert tool.markers_used == (True, True, False, True)


def test_fewer_used_markers_than_a_pose_takes_are_not_believed(make_tracker: Make, unit: Any) -> None:
    unit.marker_digits = "3" + "0" * 16 + "333"  # from the other end
    assert bring_up(make_tracker()).read_frame().tool("robot_frame").markers_used is None


@pytest.mark.hazard(14)
@pytest.mark.parametrize("hidden", [False, True])
def test_a_tool_outside_the_volume_offers_no_transform(
    tracker: PolarisTracker, unit: Any, hidden: bool
) -> None:
    unit.port_status = 0x71
    if hidden:  # a unit that withholds the pose as well
        unit.missing.add(1)
    tool = tracker.read_frame().tool("robot_frame")
    assert tool.validity is Validity.OUT_OF_VOLUME
    with raises(NO_POSE, match=r"DEV-004.*out_of_volume.*Move the tracker"):
        tool.transform(Frame.TRACKER, Frame.MARKER)


@pytest.mark.hazard(14)
@pytest.mark.parametrize(
    ("target", "source"),
    [
        (Frame.ROBOT, Frame.MARKER),
        (Frame.MARKER, Frame.TRACKER),
        (Frame.TRACKER, Frame.TRACKER),
    ],
)
def test_a_pose_in_the_tracker_frame_is_not_given_as_one_between_other_frames(
    tracker: PolarisTracker, target: Frame, source: Frame
) -> None:
    tool = tracker.read_frame().tool("robot_frame")
    with raises(FRAME_MISMATCH, match=rf"FRM-001.*robot_frame.*got {target} <- {source}.*invert"):
        tool.transform(target, source)
    assert tool.transform(Frame.TRACKER, Frame.MARKER).translation_mm == pytest.approx((10, -20, -1500))


def test_an_unknown_tool_is_refused_with_the_names_of_the_loaded_ones(tracker: PolarisTracker) -> None:
    with pytest.raises(UnknownTool, match=r"DEV-003.*no tool pointer; expected robot_frame") as caught:
        tracker.read_frame().tool("pointer")
    assert caught.value.exit_code == EXIT_USAGE


@pytest.mark.hazard(14)
def test_strays_are_averaged_over_measurements_and_phantoms_rejected(
    tracker: PolarisTracker, unit: Any
) -> None:
    usual = unit.usual("BX")

    def measuring(argument: str) -> bytes:
        number = unit.frame + 1
        if number % 3 == 2 and not unit.repeated:  # asked faster than it measures
            unit.frame, unit.repeated = unit.frame - 1, True
        else:
            unit.repeated = False
        wobble = 0.1 if number % 2 else -0.1
        unit.strays = [(100.0, 0.0, -1500.0 + wobble), (-100.0, 0.0, -1500.0)]
        if number % 4 == 0:
            unit.strays.insert(0, (0.0, 300.0, -1500.0))
        return bytes(usual(argument))

    unit.repeated = False
    unit.override("BX", measuring)
    average = average_strays(new_frames(tracker, 40))
    assert average.frames == 40
    assert [group.count for group in average.groups] == [40, 40]
    assert average.groups[0].mean_mm == pytest.approx([100, 0, -1500], abs=0.02)
    assert average.groups[0].spread_mm == pytest.approx(0.1, abs=0.01)
    assert len(average.rejected) == 1
    assert tracker.statistics.repeated > 0


@pytest.mark.hazard(14)
def test_a_missing_tool_has_validity_missing_and_no_pose(tracker: PolarisTracker, unit: Any) -> None:
    unit.missing.add(1)
    tool = tracker.read_frame().tool("robot_frame")
    assert tool.validity is Validity.MISSING
    assert tool.position_mm is None
    assert tool.rotation is None
    with raises(NO_POSE, match=r"missing.*line of sight"):
        tool.transform(Frame.TRACKER, Frame.MARKER)


@pytest.mark.parametrize(
    ("status", "validity"),
    [
        (0x31, Validity.OK),
        (0x71, Validity.OUT_OF_VOLUME),
        (0xB1, Validity.PARTIAL),
        (0x231, Validity.PARTIAL),
        (0x4031, Validity.PARTIAL),
    ],
)
def test_port_status_maps_to_a_validity(
    tracker: PolarisTracker, unit: Any, status: int, validity: Validity
) -> None:
    unit.port_status = status
    tool = tracker.read_frame().tool("robot_frame")
    assert tool.validity is validity
    assert tool.position_mm is not None


@pytest.mark.parametrize(
    "pose",
    [
        (0.5, 0.0, 0.0, 0.0, 0.0, 0.0, -1500.0, 0.1),
        (math.nan, 0.0, 0.0, 0.0, 0.0, 0.0, -1500.0, 0.1),
        (1.0, 0.0, 0.0, 0.0, math.inf, 0.0, -1500.0, 0.1),
        (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1500.0, 0.1),
        (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1500.0, -0.1),
    ],
)
def test_impossible_pose_values_are_marked_corrupt(
    tracker: PolarisTracker, unit: Any, pose: tuple[float, ...]
) -> None:
    unit.pose_of = lambda handle: pose
    tool = tracker.read_frame().tool("robot_frame")
    assert tool.validity is Validity.CORRUPT
    assert tool.position_mm is None


def test_quaternions_are_normalised_with_a_non_negative_scalar_part(
    tracker: PolarisTracker, unit: Any
) -> None:
    unit.pose_of = lambda handle: (-0.6004, 0.0, 0.8005, 0.0, 0.0, 0.0, -1500.0, 0.1)
    rotation = tracker.read_frame().tool("robot_frame").rotation
    assert rotation is not None
    assert sum(value * value for value in rotation) == pytest.approx(1.0, abs=1e-12)
    assert rotation[0] > 0
    assert rotation[2] < 0


def test_stray_validity_follows_the_volume_not_the_units_bits(tracker: PolarisTracker, unit: Any) -> None:
    unit.strays = [(0.0, 0.0, -1500.0), (0.0, 0.0, -2600.0), (900.0, 0.0, -1500.0)]
    strays = tracker.read_frame().strays
    assert [stray.validity for stray in strays] == [
        Validity.OK,
        Validity.OUT_OF_VOLUME,
        Validity.OUT_OF_VOLUME,
    ]


def test_stray_validity_follows_the_selected_volume(make_tracker: Make, unit: Any) -> None:
    unit.strays = [(0.0, 0.0, -2600.0)]
    frame = bring_up(make_tracker(volume=2)).read_frame()
    assert "VSEL:2" in unit.commands
    assert frame.strays[0].validity is Validity.OK


def test_the_units_bits_decide_stray_validity_when_no_volume_is_known(make_tracker: Make, unit: Any) -> None:
    unit.answers_to["SFLIST"] = "ERROR25"
    unit.strays = [(0.0, 0.0, -2600.0)]
    device = bring_up(make_tracker())
    assert device.volume is None
    assert device.read_frame().strays[0].validity is Validity.OK
    assert any("volume" in note for note in device.notices)


def test_strays_at_the_markers_of_a_tool_are_dropped(tracker: PolarisTracker, unit: Any) -> None:
    # a quarter turn about z: marker (45, 60, 0) of the robot frame comes to lie at (-60, 45, 0)
    half = math.sqrt(0.5)
    unit.pose_of = lambda handle: (half, 0.0, 0.0, half, 10.0, -20.0, -1500.0, 0.1)
    unit.strays = [(10.0 - 60.0, -20.0 + 45.0, -1500.0), (10.0 + 45.0, -20.0 + 60.0, -1500.0)]
    strays = tracker.read_frame().strays
    assert [stray.position_mm for stray in strays] == [(55.0, 40.0, -1500.0)]


def test_a_stray_without_a_possible_position_is_dropped(tracker: PolarisTracker, unit: Any) -> None:
    unit.strays = [(math.nan, 0.0, -1500.0), (0.0, 0.0, -1500.0), (0.0, 0.0, 2e5)]
    assert [stray.position_mm for stray in tracker.read_frame().strays] == [(0.0, 0.0, -1500.0)]


@pytest.mark.hazard(4)
def test_a_repeated_frame_number_is_stale_and_counted(tracker: PolarisTracker, unit: Any) -> None:
    tracker.read_frame()
    unit.frame -= 1
    assert tracker.read_frame().validity is Validity.STALE
    unit.frame += 4
    assert tracker.read_frame().validity is Validity.OK
    assert tracker.statistics.repeated == 1
    assert tracker.statistics.missed == 4


def test_too_much_infrared_makes_a_frame_partial(tracker: PolarisTracker, unit: Any) -> None:
    unit.system_status = 0x0002
    assert tracker.read_frame().validity is Validity.PARTIAL


def test_a_reply_without_any_frame_number_is_refused(tracker: PolarisTracker, unit: Any) -> None:
    unit.handles.clear()
    with pytest.raises(MalformedReply, match="frame number"):
        tracker.read_frame()
    assert tracker.state is Lifecycle.ACTIVE
