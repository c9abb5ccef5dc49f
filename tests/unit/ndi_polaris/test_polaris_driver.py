"""The driver as an optical tracker, on a unit in the test."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

import pytest

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.errors import LinkLost, MalformedReply, NoReply
from drivers.ndi_polaris.rom import encode_definition, planar_tool
from ronna_hw.devices import Lifecycle, OpticalTracker
from ronna_hw.devices.errors import NoPose, UnknownTool, WrongState
from ronna_hw.devices.readings import Validity
from ronna_hw.errors import EXIT_USAGE
from ronna_hw.frames import Frame

Make = Callable[..., PolarisTracker]


def bring_up(device: PolarisTracker) -> PolarisTracker:
    device.connect()
    device.configure()
    device.activate()
    return device


def test_the_driver_is_an_optical_tracker(make_tracker: Make) -> None:
    assert isinstance(make_tracker(), OpticalTracker)


def test_connecting_reads_who_answers(make_tracker: Make) -> None:
    identity = make_tracker(expected_model="spectra", expected_serial="P7-01234").connect()
    assert (identity.vendor, identity.model, identity.serial) == ("NDI", "Polaris Spectra", "P7-01234")
    assert identity.firmware == "007.000.012"
    assert dict(identity.details)["api revision"] == "G.001.005"


@pytest.mark.parametrize("left_at", [9600, 115200, 57600, 921600])
def test_the_unit_is_found_at_whatever_rate_it_was_left(make_tracker: Make, unit: Any, left_at: int) -> None:
    unit.unit_baud = left_at
    make_tracker().connect()
    assert unit.baud == left_at
    assert unit.breaks == 0


def test_a_unit_at_an_unusual_rate_is_brought_back_by_a_break(make_tracker: Make, unit: Any) -> None:
    unit.unit_baud = 1228739
    make_tracker().connect()
    assert unit.breaks == 1
    assert unit.baud == 9600


def test_a_unit_that_cannot_initialise_is_reset_once(make_tracker: Make, unit: Any) -> None:
    refusals = iter(["ERROR15"])
    usual = unit._do_init
    unit._do_init = lambda argument: next(refusals, None) or usual(argument)

    def reset(argument: str) -> str:
        unit.restart()
        return "RESET"

    unit._do_reset = reset
    unit.initialised = True
    make_tracker().connect()
    assert "RESET:0" in unit.commands
    assert unit.initialised


def test_configuring_goes_to_the_fastest_rate_both_can_do(make_tracker: Make, unit: Any) -> None:
    device = make_tracker()
    device.connect()
    device.configure()
    assert unit.unit_baud == unit.baud == device.baud == 115200
    assert [line for line in unit.commands if line.startswith("COMM")][:3] == [
        "COMM:60000",
        "COMM:A0000",
        "COMM:50000",
    ]


def test_the_fastest_rate_can_be_limited(make_tracker: Make, unit: Any) -> None:
    device = make_tracker(maximum_baud=38400)
    device.connect()
    device.configure()
    assert unit.unit_baud == 38400


def test_a_rate_at_which_the_unit_does_not_answer_is_left_again(make_tracker: Make, unit: Any) -> None:
    usual = unit._do_comm
    # says OKAY to 921600 and stays where it is
    unit._do_comm = lambda argument: "OKAY" if argument[0] == "6" else usual(argument)
    device = make_tracker()
    device.connect()
    device.configure()
    assert unit.baud == unit.unit_baud == 115200


def test_a_rate_that_the_cable_does_not_carry_is_left_by_a_break_for_a_slower_one(
    make_tracker: Make, unit: Any
) -> None:
    unit.known_bauds["6"] = 921600
    unit.deliver = lambda name, reply: [(0.001, reply if unit.unit_baud < 921600 else b"\xff\x80" * 9)]
    device = make_tracker()
    device.connect()
    device.configure(30.0)
    assert unit.breaks == 1
    assert device.baud == unit.unit_baud == 115200
    device.activate()
    assert device.read_frame().tool("robot_frame").position_mm


def test_an_answer_to_comm_that_is_lost_does_not_lose_the_unit(make_tracker: Make, unit: Any) -> None:
    unit.known_bauds = {"0": 9600, "6": 921600}
    unit.deliver = lambda name, reply: [] if name == "COMM" else [(0.001, reply)]
    device = make_tracker()
    device.connect()
    device.configure(20.0)
    assert device.baud == 921600


def test_no_rate_is_negotiated_where_none_exists(make_tracker: Make, unit: Any) -> None:
    unit.__init__(baud=None)
    device = bring_up(make_tracker())
    assert device.baud is None
    device.close()
    assert not any(line.startswith("COMM") for line in unit.commands)


def test_the_unit_tells_how_long_its_commands_may_take(make_tracker: Make, unit: Any) -> None:
    usual = unit._do_get
    told = ["BX=1.5", "TX=9", "GET=0", "INIT=900", "PHSR=soon", "NOPE=3", "TSTOP=7"]
    limits = "\n".join(f"Info.Timeout.{line}" for line in told)
    unit._do_get = lambda name: limits if name == "Info.Timeout.*" else usual(name)
    device = make_tracker(time_limits_s={"TSTOP": 3.0})
    device.connect()
    device.configure()
    unit.set_baud(9600)
    waits = {name: device._link.limit_s(name, 0, 96) for name in ("BX", "TX", "GET", "INIT", "PHSR", "TSTOP")}
    assert waits == pytest.approx({"BX": 1.6, "TX": 9.1, "GET": 8.1, "INIT": 4.1, "PHSR": 2.1, "TSTOP": 3.1})


def test_the_illuminators_are_set_to_60_hz_by_set_or_by_irate(make_tracker: Make, unit: Any) -> None:
    bring_up(make_tracker())
    assert unit.parameters["Param.Tracking.Illuminator Rate"] == "2"
    unit.restart()
    unit.answers_to["SET"] = "ERROR01"
    unit._do_irate = lambda argument: "OKAY"
    device = bring_up(make_tracker())
    assert "IRATE:2" in unit.commands
    assert device.notices == ()


def test_a_unit_that_keeps_its_own_rate_is_reported_not_refused(make_tracker: Make, unit: Any) -> None:
    unit.answers_to["SET"] = unit.answers_to["IRATE"] = "ERROR23"
    device = bring_up(make_tracker())
    assert device.notices == ("the unit keeps its illuminators at 20 Hz instead of 60 Hz",)
    for _ in range(5):
        unit.frame += 2
        device.read_frame()
    assert device.statistics.missed == 0


def test_handles_of_an_earlier_client_are_freed(make_tracker: Make, unit: Any) -> None:
    device = make_tracker()
    device.connect()
    for number in (1, 2, 7):
        unit.handles[number] = {"occupied", "initialised", "enabled"}
    device.configure()
    assert list(unit.handles) == [1]
    assert unit.handles[1] == {"occupied", "initialised", "enabled"}


def test_the_definition_arrives_whole_and_zero_padded(make_tracker: Make, unit: Any) -> None:
    bring_up(make_tracker())
    assert unit.memory[1][580:585] == b"RONNA"
    assert not any(unit.memory[1][752:])


def test_a_warning_to_pinit_is_success_and_reported(make_tracker: Make, unit: Any) -> None:
    usual = unit._do_pinit
    unit._do_pinit = lambda argument: "WARNING05" if usual(argument) == "OKAY" else "ERROR13"
    device = bring_up(make_tracker())
    assert any("wavelength" in note for note in device.notices)


def test_a_tool_whose_marker_distances_are_alike_is_reported(make_tracker: Make, tmp_path: Path) -> None:
    corners = ((0.0, 0.0, 0.0), (50.0, 0.0, 0.0), (50.0, 60.0, 0.0), (0.0, 60.0, 0.0))
    rectangle = planar_tool("BOX", corners, manufacturer="TEST", made_on=date(2025, 1, 1))
    (tmp_path / "box.rom").write_bytes(encode_definition(rectangle))
    device = bring_up(make_tracker(tools=[{"name": "box", "rom": str(tmp_path / "box.rom")}]))
    assert any("50.0 and 50.0 mm" in note for note in device.notices)


def test_a_lost_reply_to_phrq_leaves_no_orphan_handle(make_tracker: Make, unit: Any) -> None:
    lost = iter([True])
    unit.deliver = lambda name, reply: [] if name == "PHRQ" and next(lost, False) else [(0.001, reply)]
    bring_up(make_tracker())
    assert len(unit.handles) == 1


def test_without_tools_a_dummy_tool_lights_the_strays(make_tracker: Make, unit: Any) -> None:
    unit.strays = [(0.0, 0.0, -1500.0)]
    frame = bring_up(make_tracker(tools=[])).read_frame()
    assert "PHRQ:*********1**01" in unit.commands
    assert frame.tools == ()
    assert len(frame.strays) == 1


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
    assert device.read_frame().stamp.device_clock == 1
    assert device.statistics.frames == 2


def test_one_reading_is_one_request(tracker: PolarisTracker, unit: Any) -> None:
    before = len(unit.commands)
    tracker.read_frame()
    assert unit.commands[before:] == ["BX:1801"]


def test_a_unit_without_binary_replies_is_read_by_text(make_tracker: Make, unit: Any) -> None:
    unit.answers_to["BX"] = "ERROR01"
    device = bring_up(make_tracker())
    device.read_frame()
    device.read_frame()
    assert unit.commands.count("BX:1801") == 1
    assert unit.commands.count("TX:1801") == 2


@pytest.mark.hazard(14)
@pytest.mark.parametrize("hidden", [False, True])
def test_a_tool_outside_the_volume_has_no_pose_to_build_on(
    tracker: PolarisTracker, unit: Any, hidden: bool
) -> None:
    unit.port_status = 0x71
    if hidden:  # a unit that withholds the pose as well
        unit.missing.add(1)
    tool = tracker.read_frame().tool("robot_frame")
    assert tool.validity is Validity.OUT_OF_VOLUME
    with pytest.raises(NoPose, match=r"DEV-004.*out_of_volume.*Move the tracker"):
        tool.transform(Frame.TRACKER, Frame.MARKER)


def test_a_tool_that_is_not_loaded_is_named_with_those_that_are(tracker: PolarisTracker) -> None:
    with pytest.raises(UnknownTool, match=r"DEV-003.*no tool pointer.*robot_frame") as caught:
        tracker.read_frame().tool("pointer")
    assert caught.value.exit_code == EXIT_USAGE


@pytest.mark.hazard(14)
def test_strays_are_averaged_over_measurements_and_phantoms_rejected(
    tracker: PolarisTracker, unit: Any
) -> None:
    usual = unit._do_bx

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
    unit._do_bx = measuring
    average = tracker.average_strays(40)
    assert average.frames == 40
    assert [group.count for group in average.groups] == [40, 40]
    assert average.groups[0].mean_mm == pytest.approx([100, 0, -1500], abs=0.02)
    assert average.groups[0].spread_mm == pytest.approx(0.1, abs=0.01)
    assert len(average.rejected) == 1
    assert tracker.statistics.repeated > 0


def test_a_unit_that_repeats_one_measurement_gives_no_average(tracker: PolarisTracker, unit: Any) -> None:
    usual = unit._do_bx

    def stuck(argument: str) -> bytes:
        unit.frame = 4
        return bytes(usual(argument))

    unit._do_bx = stuck
    with pytest.raises(NoReply, match="too few measurements"):
        tracker.average_strays(10, timeout_s=0.5)


@pytest.mark.hazard(14)
def test_a_missing_tool_is_a_validity(tracker: PolarisTracker, unit: Any) -> None:
    unit.missing.add(1)
    tool = tracker.read_frame().tool("robot_frame")
    assert tool.validity is Validity.MISSING
    assert tool.position_mm is None
    assert tool.rotation is None
    with pytest.raises(NoPose, match=r"missing.*line of sight"):
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
def test_port_status_becomes_a_validity(
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
def test_numbers_that_cannot_be_a_pose_are_corrupt(
    tracker: PolarisTracker, unit: Any, pose: tuple[float, ...]
) -> None:
    unit.pose_of = lambda handle: pose
    tool = tracker.read_frame().tool("robot_frame")
    assert tool.validity is Validity.CORRUPT
    assert tool.position_mm is None


def test_quaternions_are_normalised_with_a_scalar_part_that_is_not_negative(
    tracker: PolarisTracker, unit: Any
) -> None:
    unit.pose_of = lambda handle: (-0.6004, 0.0, 0.8005, 0.0, 0.0, 0.0, -1500.0, 0.1)
    rotation = tracker.read_frame().tool("robot_frame").rotation
    assert rotation is not None
    assert sum(value * value for value in rotation) == pytest.approx(1.0, abs=1e-12)
    assert rotation[0] > 0
    assert rotation[2] < 0


def test_strays_are_judged_by_the_volume_not_by_the_units_bits(tracker: PolarisTracker, unit: Any) -> None:
    unit.strays = [(0.0, 0.0, -1500.0), (0.0, 0.0, -2600.0), (900.0, 0.0, -1500.0)]
    strays = tracker.read_frame().strays
    assert [stray.validity for stray in strays] == [
        Validity.OK,
        Validity.OUT_OF_VOLUME,
        Validity.OUT_OF_VOLUME,
    ]


def test_the_selected_volume_is_the_one_that_judges(make_tracker: Make, unit: Any) -> None:
    unit.strays = [(0.0, 0.0, -2600.0)]
    frame = bring_up(make_tracker(volume=2)).read_frame()
    assert "VSEL:2" in unit.commands
    assert frame.strays[0].validity is Validity.OK


def test_without_a_volume_the_units_bits_have_to_do(make_tracker: Make, unit: Any) -> None:
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


def test_a_stray_without_a_place_is_no_reading(tracker: PolarisTracker, unit: Any) -> None:
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


def test_too_much_infrared_makes_a_frame_doubtful(tracker: PolarisTracker, unit: Any) -> None:
    unit.system_status = 0x0002
    assert tracker.read_frame().validity is Validity.PARTIAL


def test_a_reply_without_any_frame_number_is_refused(tracker: PolarisTracker, unit: Any) -> None:
    unit.handles.clear()
    with pytest.raises(MalformedReply, match="frame number"):
        tracker.read_frame()
    assert tracker.state is Lifecycle.ACTIVE


def test_a_reading_that_is_late_costs_only_itself(tracker: PolarisTracker, unit: Any) -> None:
    late = iter([True])
    unit.deliver = lambda name, reply: [(1.5 if name == "BX" and next(late, False) else 0.001, reply)]
    with pytest.raises(NoReply):
        tracker.read_frame()
    frame = tracker.read_frame()
    assert frame.stamp.device_clock == unit.frame
    assert tracker.state is Lifecycle.ACTIVE


def test_calls_out_of_order_are_refused(make_tracker: Make) -> None:
    device = make_tracker()
    for call in (device.configure, device.activate, device.deactivate, device.read_frame):
        with pytest.raises(WrongState):
            call()
    device.connect()
    with pytest.raises(WrongState):
        device.connect()
    device.configure()
    device.activate()
    with pytest.raises(WrongState):
        device.activate()
    with pytest.raises(WrongState):
        device.recover("tester")


def test_tracking_stops_and_starts_again_at_frame_0(tracker: PolarisTracker) -> None:
    for _ in range(3):
        tracker.read_frame()
    tracker.deactivate()
    assert tracker.state is Lifecycle.CONFIGURED
    tracker.activate()
    assert tracker.read_frame().stamp.device_clock == 0


def test_a_start_whose_answer_was_lost_can_be_repeated(make_tracker: Make, unit: Any) -> None:
    device = make_tracker()
    device.connect()
    device.configure()
    lost = iter([True])
    unit.deliver = lambda name, reply: [] if name == "TSTART" and next(lost, False) else [(0.001, reply)]
    with pytest.raises(NoReply):
        device.activate()
    device.activate()
    assert device.read_frame().stamp.device_clock == 0


def test_closing_leaves_the_unit_as_it_was_at_power_up(tracker: PolarisTracker, unit: Any) -> None:
    tracker.close()
    assert not unit.tracking
    assert unit.handles == {}
    assert unit.unit_baud == 9600
    assert tracker.state is Lifecycle.CLOSED
    tracker.close()


def test_closing_a_dead_link_is_bounded_and_quiet(tracker: PolarisTracker, unit: Any) -> None:
    unit.silent = True
    began_s = unit.now_s
    tracker.close()
    assert unit.now_s - began_s <= 1.6
    assert tracker.state is Lifecycle.CLOSED


def test_closing_after_the_port_vanished_is_quiet(tracker: PolarisTracker, unit: Any) -> None:
    unit.closed = True
    with pytest.raises(LinkLost):
        tracker.read_frame()
    tracker.close()
    assert tracker.state is Lifecycle.CLOSED


def test_frames_leave_no_memory_behind(tracker: PolarisTracker, unit: Any, clock: Any) -> None:
    """The million frames are read by `make soak`."""

    def read(frames: int) -> None:
        for _ in range(frames):
            clock.time_s += 1 / 60
            tracker.read_frame()
            unit.commands.clear()

    read(60 * 70)  # more than the minute that the fit of the clock keeps
    tracemalloc.start()
    read(100)
    before, _ = tracemalloc.get_traced_memory()
    read(2000)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 20_000  # ten bytes per frame would be found
