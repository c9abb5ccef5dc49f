"""Cases that every optical tracker must pass, whatever its protocol."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Iterator
from functools import partial
from typing import Any

from conformance.case import CHECKED_REPLIES, LINE_FAULTS, NotShown, Suite, check, refused
from conformance.device_cases import (
    SLACK_S,
    DeviceCases,
    check_closing,
    check_connect_nowhere,
    check_early_calls,
    check_identity,
    check_interface,
    check_unknown_option,
    ends_within,
    observe,
)
from conformance.device_under_test import DeviceUnderTest
from conformance.disturbed_line import DisturbedLine
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import ToolReading, TrackerFrame, Validity
from ronna_hw.devices.sensors import OpticalTracker
from ronna_hw.errors import LinkTimeout, ProtocolError, RonnaError, StateError

FRAMES = 15
CLOSE_LIMIT_S = 5.0
NORM_TOLERANCE = 1e-6  # readings are normalised, whatever the wire rounds
READ_LIMIT_S = 0.5
PAUSE_S = 0.4
CONNECT_LIMIT_S = 3.0
CARRY_POSE = frozenset({Validity.OK, Validity.PARTIAL})
WITHOUT_POSE = frozenset({Validity.MISSING, Validity.CORRUPT})
RECOVERY_READS = 12  # readings after which a cut line must have been noticed

SUITE = Suite("tracker", driver="ndi_polaris")


def read_frames(dut: DeviceUnderTest, count: int = FRAMES) -> list[TrackerFrame]:
    """Read consecutive frames on the shared connection, no faster than the tracker measures."""
    tracker: OpticalTracker = dut.at(Lifecycle.ACTIVE)
    frames = []
    for _ in range(count):
        frames.append(tracker.read_frame())
        dut.clock.sleep(1 / 60)
    return frames


def read_tools(dut: DeviceUnderTest) -> list[ToolReading]:
    """Return every tool reading from several frames; raises NotShown if no tool is configured."""
    readings = [reading for frame in read_frames(dut) for reading in frame.tools]
    if not readings:
        raise NotShown("no tool is configured")
    return readings


@contextlib.contextmanager
def disturbed_tracker(dut: DeviceUnderTest) -> Iterator[tuple[DisturbedLine, Any]]:
    """Yield a disturbable line and an active tracker on it; all connections are closed afterwards."""
    with dut.disturbed_line() as line:
        yield line, dut.bring_to(Lifecycle.ACTIVE, dut.make(endpoint=line.endpoint))
        dut.release()


SUITE.case("T01", "the driver implements OpticalTracker and starts disconnected")(
    partial(check_interface, interface=OpticalTracker)
)


SUITE.case("T02", "connecting identifies the device")(check_identity)


@SUITE.case("T03", "calls in the wrong state are refused")
def early_calls_are_refused(dut: DeviceUnderTest) -> None:
    check_early_calls(
        dut,
        disconnected=("configure", "activate", "deactivate", "read_frame"),
        connected=("connect", "activate", "read_frame"),
    )


@SUITE.case("T04", "configuring loads the tools of the theatre file")
def configure_loads_tools(dut: DeviceUnderTest) -> None:
    tracker = dut.at(Lifecycle.CONFIGURED)
    check(tracker.state is Lifecycle.CONFIGURED, "state configured", tracker.state)
    names = tracker.tools
    check(len(set(names)) == len(names), "unique tool names", names)
    refused(tracker.read_frame, StateError, "read_frame before activate")


@SUITE.case("T05", "activating twice is refused")
def second_start_is_refused(dut: DeviceUnderTest) -> None:
    tracker = dut.at(Lifecycle.ACTIVE)
    refused(tracker.activate, StateError, "activate while active")
    tracker.read_frame()


@SUITE.case("T06", "the frame number increases and never goes backwards")
def frame_number_advances(dut: DeviceUnderTest) -> None:
    numbers = [frame.stamp.device_clock for frame in read_frames(dut)]
    check(all(b >= a for a, b in itertools.pairwise(numbers)), "numbers that never decrease", numbers)
    check(numbers[-1] > numbers[0], "numbers that increase", numbers)


@SUITE.case("T07", "readings are numbered consecutively, and theatre time never goes backwards")
def stamps_are_in_order(dut: DeviceUnderTest) -> None:
    stamps = [frame.stamp for frame in read_frames(dut)]
    for before, after in itertools.pairwise(stamps):
        check(after.sequence == before.sequence + 1, f"reading {before.sequence + 1}", after.sequence)
        check(after.theatre_time_s >= before.theatre_time_s, "a later theatre time", after.theatre_time_s)


@SUITE.case("T08", "every frame lists every tool in the order of the theatre file, seen or not")
def every_tool_is_listed(dut: DeviceUnderTest) -> None:
    frames = read_frames(dut, 3)
    names = dut.at(Lifecycle.ACTIVE).tools
    for frame in frames:
        found = tuple(reading.tool for reading in frame.tools)
        check(found == names, f"the tools {names}", found)


@SUITE.case("T09", "a reading has a pose exactly when its validity says so; missing data is never a number")
def pose_and_validity_agree(dut: DeviceUnderTest) -> None:
    readings = read_tools(dut)
    # A protocol may know no fit error; one that does states it with every pose.
    states_errors = any(reading.fit_error_mm is not None for reading in readings)
    for reading in readings:
        pose = (reading.rotation, reading.position_mm)
        if reading.validity in CARRY_POSE:
            check(None not in pose, f"a pose with validity {reading.validity}", reading)
            is_stated = reading.fit_error_mm is not None
            check(is_stated is states_errors, "a fit error with every pose or with none", reading)
        if reading.validity in WITHOUT_POSE:
            is_empty = (*pose, reading.fit_error_mm) == (None, None, None)
            check(is_empty, f"no pose with validity {reading.validity}", reading)
        numbers = (*(reading.rotation or ()), *(reading.position_mm or ()), reading.fit_error_mm or 0.0)
        check(all(math.isfinite(number) for number in numbers), "finite numbers", reading)


@SUITE.case("T10", "poses are plausible: z is negative, quaternions have norm 1")
def poses_are_possible(dut: DeviceUnderTest) -> None:
    seen = [reading for reading in read_tools(dut) if reading.position_mm and reading.rotation]
    if not seen:
        raise NotShown("no tool is in view")
    for reading in seen:
        norm = math.sqrt(sum(value * value for value in reading.rotation or ()))
        check(abs(norm - 1.0) <= NORM_TOLERANCE, "a quaternion of norm 1", norm)
        check((reading.position_mm or (0, 0, 0))[2] < 0, "a negative z", reading.position_mm)


@SUITE.case("T11", "the fit error of a pose is not negative")
def fit_error_is_not_negative(dut: DeviceUnderTest) -> None:
    errors = [reading.fit_error_mm for reading in read_tools(dut) if reading.fit_error_mm is not None]
    if not errors:
        raise NotShown("no tool is in view, or its poses come without a fit error")
    check(min(errors) >= 0, "errors of 0 or more", min(errors))


@SUITE.case("T12", "strays have a position and a validity, never NaN")
def strays_have_places(dut: DeviceUnderTest) -> None:
    strays = [stray for frame in read_frames(dut) for stray in frame.strays]
    if not strays:
        raise NotShown("no stray marker is in view")
    for stray in strays:
        check(all(math.isfinite(value) for value in stray.position_mm), "finite numbers", stray)
        check(stray.validity in (Validity.OK, Validity.OUT_OF_VOLUME), "validity OK or OUT_OF_VOLUME", stray)


@SUITE.case("T13", "tracking can be stopped and started again on one connection")
def stop_and_start_again(dut: DeviceUnderTest) -> None:
    tracker = dut.at(Lifecycle.ACTIVE)
    tracker.deactivate()
    check(tracker.state is Lifecycle.CONFIGURED, "state configured", tracker.state)
    refused(tracker.read_frame, StateError, "read_frame after deactivate")
    tracker.activate()
    tracker.read_frame()


SUITE.case("T14", "closing ends in bounded time, is final and may be repeated")(
    lambda dut: check_closing(dut.at(Lifecycle.ACTIVE), CLOSE_LIMIT_S)
)


@SUITE.case("T15", "reconnecting opens a new connection to the same device")
def reconnecting_starts_afresh(dut: DeviceUnderTest) -> None:
    first = dut.bring_to(Lifecycle.ACTIVE, dut.make())
    first.read_frame()
    first.close()
    second = dut.make()
    identity = second.connect()
    again = dut.make().connect()
    check(identity == again, f"the identity {identity}", again)
    dut.at(Lifecycle.ACTIVE).read_frame()


SUITE.case("T16", "connecting to an endpoint without a device fails in time, with code and advice")(
    partial(check_connect_nowhere, limit_s=CONNECT_LIMIT_S)
)


SUITE.case("T17", "an unknown option is refused by the constructor")(check_unknown_option)


@SUITE.case("T18", "a reading on a silent line ends at its time limit", needs=(LINE_FAULTS,))
def silence_ends_a_reading(dut: DeviceUnderTest) -> None:
    with disturbed_tracker(dut) as (line, tracker):
        line.silence()
        with ends_within(READ_LIMIT_S + SLACK_S):
            refused(lambda: tracker.read_frame(READ_LIMIT_S), LinkTimeout, "read_frame on a silent line")
        line.silence(False)


@SUITE.case("T19", "closing on a silent line ends in bounded time and raises nothing", needs=(LINE_FAULTS,))
def close_on_a_dead_line(dut: DeviceUnderTest) -> None:
    with disturbed_tracker(dut) as (line, tracker):
        line.silence()
        with ends_within(CLOSE_LIMIT_S):
            tracker.close()
        check(tracker.state is Lifecycle.CLOSED, "state closed", tracker.state)


@SUITE.case("T20", "a late reply costs one reading and never answers the next request", needs=(LINE_FAULTS,))
def late_reply(dut: DeviceUnderTest) -> None:
    with disturbed_tracker(dut) as (line, tracker):
        tracker.read_frame()
        line.delay_next(READ_LIMIT_S + 0.1)
        refused(lambda: tracker.read_frame(READ_LIMIT_S), RonnaError, "a reading whose reply is late")
        tracker.read_frame(2.0)
        first = tracker.read_frame(2.0).stamp.device_clock
        dut.clock.sleep(PAUSE_S)
        second, third = (tracker.read_frame(2.0).stamp.device_clock for _ in range(2))
        # If every reply belonged to the previous request, the pause would show one reading late.
        check(third - second <= second - first, "a fresh frame after a pause", (first, second, third))


@SUITE.case("T21", "a broken connection latches a fault that only recover clears", needs=(LINE_FAULTS,))
def broken_connection(dut: DeviceUnderTest) -> None:
    with disturbed_tracker(dut) as (line, tracker):
        line.cut()
        for _ in range(RECOVERY_READS):
            if tracker.state is Lifecycle.FAULT:
                break
            with contextlib.suppress(RonnaError):
                tracker.read_frame(READ_LIMIT_S)
        check(tracker.state is Lifecycle.FAULT, "state fault", tracker.state)
        refused(tracker.read_frame, StateError, "read_frame in fault")
        check(observe(tracker, Lifecycle.FAULT).fault is not None, "the fault observed")
        tracker.recover("conformance suite")
        check(tracker.state is Lifecycle.CONFIGURED, "state configured", tracker.state)
        dut.bring_to(Lifecycle.ACTIVE, tracker).read_frame()


@SUITE.case(
    "T22",
    "a reply with a flipped bit or a lost byte never becomes a reading",
    needs=(LINE_FAULTS, CHECKED_REPLIES),
)
def wrong_bits_are_noticed(dut: DeviceUnderTest) -> None:
    with disturbed_tracker(dut) as (line, tracker):
        for disturb in (line.flip_next, line.lose_next_byte):
            before = tracker.read_frame().stamp
            disturb()
            # a retry is allowed, a wrong reading is not
            with contextlib.suppress(ProtocolError, LinkTimeout):
                after = tracker.read_frame(2.0).stamp
                check(after.device_clock >= before.device_clock, "a later frame", after)
            tracker.read_frame(2.0)


SUITE.cases.extend(DeviceCases(lambda tracker: tracker.read_frame(), CLOSE_LIMIT_S).build_cases("T", 23))


@SUITE.case("T27", "observing a silent line asks nothing and latches nothing", needs=(LINE_FAULTS,))
def observing_a_silent_line(dut: DeviceUnderTest) -> None:
    with disturbed_tracker(dut) as (line, tracker):
        tracker.read_frame()
        line.silence()
        for _ in range(FRAMES):
            observe(tracker, Lifecycle.ACTIVE)
        line.silence(False)
        tracker.read_frame()
