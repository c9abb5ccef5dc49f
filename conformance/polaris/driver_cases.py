"""Checklist lines 11 to 16 and 37 to 43: behaviour of the driver, observed through a tap on its line."""

from __future__ import annotations

import contextlib
import math
import struct
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from conformance.case import LINE_FAULTS, CaseList, NotShown, check, refused
from conformance.device_under_test import DeviceUnderTest
from conformance.polaris.client import (
    OPTION_OUT_OF_VOLUME,
    OPTION_STRAYS,
    Vector3,
    idle_unit,
    place_markers,
    plain_unit,
    read_body,
    with_crc,
)
from conformance.polaris.fixtures import (
    NEEDS,
    SERIAL,
    SPECTRA_SHAPE,
    TOOL_DEFINITION,
    WITH_TOOL,
    ReportsBaud,
    definition,
    read_markers,
    volume_in_use,
)
from conformance.polaris.tap import (
    PolarisTap,
    body_of,
    polaris_tap,
    with_body,
    with_system_status,
)
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import Validity
from ronna_hw.errors import (
    ConfigurationError,
    DeviceError,
    LinkTimeout,
    ProtocolError,
    RonnaError,
    StateError,
)
from ronna_hw.wire.polaris import (
    DEFAULT_BAUD,
    PARAMETER_ILLUMINATOR_RATE,
    PARAMETER_NEW_ALERTS,
    Alert,
    SystemStatus,
)

TAPPED = (*NEEDS, LINE_FAULTS)
TAPPED_TOOL = (*TAPPED, TOOL_DEFINITION)
SLOW_REPLY_S = 1.0  # the unit itself may take 2 s and more
PATIENT_S = 5.0
ARRIVAL_S = 0.1  # for injected bytes to reach the driver
NORM_TOLERANCE = 1e-6
NEAR_MARKER_MM = 1.0
FAR_OUTSIDE_MM = (3000.0, 0.0, -1500.0)  # beyond the side of every volume
STALE_TEXT = with_crc("OKAY")
READING_OPTIONS = OPTION_OUT_OF_VOLUME | OPTION_STRAYS | 0x0001
DISTURBED_BYTES = {"start": 0, "length": 2, "header CRC": 4, "body": 20, "body CRC": -1}

CASES = CaseList()
case = CASES.case


def reading_command(tap: PolarisTap) -> str:
    """Return the command with which this driver reads frames: BX or TX."""
    return "BX" if tap.count("BX:") else "TX"


@contextlib.contextmanager
def tapped_tracker(dut: DeviceUnderTest, **options: Any) -> Iterator[tuple[PolarisTap, Any]]:
    with polaris_tap(dut) as tap:
        tracker = dut.make(endpoint=tap.endpoint, options={**dut.config.options, **options})
        dut.bring_to(Lifecycle.ACTIVE, tracker).read_frame(PATIENT_S)
        try:
            yield tap, tracker
        finally:
            dut.release()


@case("D11", "the driver waits for a reply as long as the unit's time limit allows", needs=TAPPED)
def waits_for_a_slow_unit(dut: DeviceUnderTest) -> None:
    with tapped_tracker(dut) as (tap, tracker):
        name = reading_command(tap)
        earlier_requests = tap.count(name)
        tap.change(name, lambda reply: reply, delay_s=SLOW_REPLY_S)
        began_s = time.monotonic()
        tracker.read_frame(PATIENT_S)
        check(time.monotonic() - began_s >= SLOW_REPLY_S, f"a reading after {SLOW_REPLY_S:g} s")
        check(tap.count(name) == earlier_requests + 1, "one request", tap.count(name) - earlier_requests)


@case("D12", "unsolicited bytes are never taken for a reply", needs=TAPPED)
def stale_input_is_dropped(dut: DeviceUnderTest) -> None:
    with tapped_tracker(dut) as (tap, tracker):
        name = reading_command(tap)
        for stale in (STALE_TEXT, tap.replies[name], b"\xc4\xa5\x00", b"\xff" * 40):
            before = tracker.read_frame(PATIENT_S).stamp.device_clock
            tap.inject(stale)
            time.sleep(ARRIVAL_S)
            dut.clock.sleep(ARRIVAL_S)
            earlier_requests = tap.count(name)
            frame = tracker.read_frame(PATIENT_S)
            check(tap.count(name) > earlier_requests, "a new request", tap.commands[-3:])
            if frame.stamp.device_clock == before and not dut.clock_known:
                raise NotShown("the unit's time rests between requests; give its clock with --config")
            check(frame.stamp.device_clock > before, "a different frame", frame.stamp.device_clock)


@case("D13", "a reply with a wrong CRC, of text, header or body, never becomes a reading", needs=TAPPED)
def every_crc_is_checked(dut: DeviceUnderTest) -> None:
    with tapped_tracker(dut) as (tap, tracker):
        name = reading_command(tap)
        places = DISTURBED_BYTES if name == "BX" else {"text": 8, "CRC": -2}
        for place, index in places.items():
            earlier_requests = tap.count(name)
            tap.change(name, _flip_bit(index))
            with contextlib.suppress(ProtocolError, LinkTimeout):
                tracker.read_frame(PATIENT_S)
                check(tap.count(name) > earlier_requests + 1, f"no reading with a wrong {place}")
            tracker.read_frame(PATIENT_S)


@case("D14", "a harmless command is repeated when its reply is lost; PHRQ is not", needs=TAPPED_TOOL)
def retries_are_harmless(dut: DeviceUnderTest) -> None:
    with tapped_tracker(dut) as (tap, tracker):
        name = reading_command(tap)
        tap.change(name, lambda reply: reply[:-1])
        tracker.read_frame(PATIENT_S)
    with polaris_tap(dut) as tap:
        tracker = dut.bring_to(Lifecycle.CONNECTED, dut.make(endpoint=tap.endpoint))
        tap.change("PHRQ", lambda _reply: b"")
        with contextlib.suppress(RonnaError):
            tracker.configure()
        names = [command.partition(":")[0] for command in tap.commands]
        requests = [index for index, command in enumerate(names) if command == "PHRQ"]
        between = names[requests[0] : requests[1]] if len(requests) > 1 else ["PHSR"]
        check("PHSR" in between, "no second PHRQ before PHSR", between)
        dut.release()


@case("D15", "each ERRORhh becomes a typed error that names it", needs=TAPPED_TOOL)
def errors_are_typed(dut: DeviceUnderTest) -> None:
    steps = {"PHRQ": "ERROR2D", "PINIT": "ERROR13", "PENA": "ERROR28", "TSTART": "ERROR12"}
    codes: set[str] = set()
    for name, text in steps.items():
        with polaris_tap(dut) as tap:
            tracker = dut.make(endpoint=tap.endpoint)
            tap.answer(name, text)
            error = refused(partial(dut.bring_to, Lifecycle.ACTIVE, tracker), RonnaError, text)
            check(bool(error.code), "an error with a code", repr(error))
            check(text in str(error), f"{text} in the message", error)
            codes.add(error.code)
            dut.release()
    check(len(codes) > 1, "errors of several kinds", codes)


@case("D16", "WARNINGhh counts as success and is reported in the notices", needs=TAPPED_TOOL)
def warnings_are_success(dut: DeviceUnderTest) -> None:
    with polaris_tap(dut) as tap:
        tracker = dut.make(endpoint=tap.endpoint)
        tap.answer("PINIT", "WARNING05")
        dut.bring_to(Lifecycle.ACTIVE, tracker).read_frame(PATIENT_S)
        notices = tracker.notices
        dut.release()
    check(any("wavelength" in notice or "05" in notice for notice in notices), "the warning", notices)


@case(
    "D37",
    "strays are requested with 1801 and filtered by position: outside, or a tool's marker",
    needs=TAPPED_TOOL,
)
def strays_are_filtered(dut: DeviceUnderTest) -> None:
    markers_mm = read_markers(definition(dut))
    with idle_unit(dut) as unit:
        is_formula_public = volume_in_use(unit).shape == SPECTRA_SHAPE
    with tapped_tracker(dut) as (tap, tracker):
        name = reading_command(tap)
        earlier_requests = [command for command in tap.commands if command.startswith(f"{name}:")]
        check(
            all(command == f"{name}:1801" for command in earlier_requests),
            f"{name}:1801",
            earlier_requests[:1],
        )
        frame = read_body(body_of(tap.replies["BX"]), READING_OPTIONS) if name == "BX" else None
        if frame is None or not frame.strays_mm or frame.handles[0].pose is None:
            raise NotShown("no frame with a tool and a stray marker came by BX")
        tap.change("BX", _move_first_stray(lambda _pose: FAR_OUTSIDE_MM))
        strays = tracker.read_frame(PATIENT_S).strays
        far = [stray for stray in strays if math.dist(stray.position_mm, FAR_OUTSIDE_MM) < NEAR_MARKER_MM]
        if is_formula_public:  # otherwise only the unit's own flag is available
            check(all(s.validity is Validity.OUT_OF_VOLUME for s in far), "validity out of volume", far)
        tap.change("BX", _move_first_stray(lambda pose: place_markers(markers_mm, pose)[0]))
        strays = tracker.read_frame(PATIENT_S).strays
        pose = read_body(body_of(tap.replies["BX"]), READING_OPTIONS).handles[0].pose
        if pose is None:
            raise NotShown("the tool was lost")
        marker_mm = place_markers(markers_mm, pose)[0]
        near = [stray for stray in strays if math.dist(stray.position_mm, marker_mm) < NEAR_MARKER_MM]
        check(not near, "no stray at a tool's marker", near)


@case("D38", "quaternions of TX, rounded to 1e-4, are normalised", needs=TAPPED_TOOL)
def rounded_quaternions(dut: DeviceUnderTest) -> None:
    try:
        dut.make(options={**dut.config.options, "reply": "TX"})
    except ConfigurationError as error:
        raise NotShown("the driver has no option to read with TX") from error
    with tapped_tracker(dut, reply="TX") as (tap, tracker):
        check(reading_command(tap) == "TX", "readings by TX", tap.commands[-1])
        rotations = [tool.rotation for tool in tracker.read_frame(PATIENT_S).tools if tool.rotation]
        if not rotations:
            raise NotShown("no tool is in view")
        for rotation in rotations:
            norm = math.sqrt(sum(value * value for value in rotation))
            check(abs(norm - 1.0) <= NORM_TOLERANCE, "norm 1", norm)


@case("D39", "the frame number decides: a repeated frame is STALE, an older one is rejected", needs=TAPPED)
def frame_numbers_decide(dut: DeviceUnderTest) -> None:
    with tapped_tracker(dut) as (tap, tracker):
        name = reading_command(tap)
        first = tracker.read_frame(PATIENT_S).stamp.device_clock
        old = tap.replies[name]
        tap.change(name, lambda _reply: old)
        again = tracker.read_frame(PATIENT_S)
        check(again.stamp.device_clock == first, f"frame {first} again", again.stamp.device_clock)
        check(again.validity is Validity.STALE, "validity stale", again.validity)
        dut.clock.sleep(0.1)
        newer = tracker.read_frame(PATIENT_S).stamp.device_clock
        check(newer > first, f"a frame after {first}", newer)
        tap.change(name, lambda _reply: old)
        with contextlib.suppress(RonnaError):
            after = tracker.read_frame(PATIENT_S).stamp.device_clock
            check(after >= newer, f"no frame older than {newer}", after)


@case("D40", "the driver sets the illuminators to the fastest rate before tracking", needs=TAPPED)
def illuminators_are_set(dut: DeviceUnderTest) -> None:
    with tapped_tracker(dut) as (tap, _):
        start = next(index for index, sent in enumerate(tap.commands) if sent.startswith("TSTART"))
        wanted = (f"SET:{PARAMETER_ILLUMINATOR_RATE}=", "IRATE:")
        sent = [command for command in tap.commands[:start] if command.startswith(wanted)]
        check(bool(sent), " or ".join(wanted), "neither")
        if "illuminator_rate_hz" not in dut.config.options:
            check(sent[0].endswith("2"), "rate 2, which is 60 Hz", sent[0])


@case("D40b", "on a serial line the driver switches to a faster baud rate", needs=SERIAL)
def rate_is_raised(dut: DeviceUnderTest) -> None:
    tracker = dut.at(Lifecycle.ACTIVE)
    tracker.read_frame(PATIENT_S)  # at its working rate
    baud = tracker.baud if isinstance(tracker, ReportsBaud) else None
    dut.release()
    if baud is None:
        raise NotShown("the driver does not report its baud rate")
    check(baud > DEFAULT_BAUD, f"more than {DEFAULT_BAUD} baud", baud)


@case(
    "D41",
    "on closing, the driver stops tracking, frees its handles and restores the baud rate",
    needs=WITH_TOOL,
)
def leaves_the_unit_idle(dut: DeviceUnderTest) -> None:
    dut.bring_to(Lifecycle.ACTIVE, dut.make()).read_frame(PATIENT_S)
    with plain_unit(dut) as unit:  # at the power-up rate, without INIT
        unit.refused("BX:0001", 0x0C)
        check(unit.handles() == [], "no handles", unit.handles())


def _flip_bit(index: int) -> Callable[[bytes], bytes]:
    def flip(reply: bytes) -> bytes:
        at = index % len(reply)
        return reply[:at] + bytes([reply[at] ^ 0x04]) + reply[at + 1 :]

    return flip


def _move_first_stray(place: Callable[[tuple[float, ...]], Vector3]) -> Callable[[bytes], bytes]:
    """Build a change that moves the first stray of a reply without changing its in-volume flag."""

    def change(reply: bytes) -> bytes:
        body = bytearray(body_of(reply))
        frame = read_body(bytes(body), READING_OPTIONS)
        pose = frame.handles[0].pose
        if frame.strays_mm and pose is not None:
            struct.pack_into("<3f", body, frame.strays_at, *place(pose))
        return with_body(bytes(body))

    return change


@case("D42", "on system status 0100 the driver reads the alerts; a bump latches a fault", needs=TAPPED)
def bump_is_a_fault(dut: DeviceUnderTest) -> None:
    with tapped_tracker(dut) as (tap, tracker):
        name = reading_command(tap)
        tap.change(name, lambda reply: with_system_status(reply, SystemStatus.DIAGNOSTICS_PENDING))
        tap.answer("GET", f"{PARAMETER_NEW_ALERTS}={int(Alert.BUMP)}")
        error = refused(lambda: tracker.read_frame(PATIENT_S), DeviceError, "a reading from a bumped unit")
        check(bool(error.code), "an error with a code", repr(error))
        check(tap.count(f"GET:{PARAMETER_NEW_ALERTS}") > 0, "a read of the alerts", tap.commands[-3:])
        check(tracker.state is Lifecycle.FAULT, "state fault", tracker.state)
        refused(lambda: tracker.read_frame(PATIENT_S), StateError, "read_frame in fault")


@case("D43", "on system status 0200 poses are withheld until it clears", needs=TAPPED)
def temperature_is_a_hold(dut: DeviceUnderTest) -> None:
    with tapped_tracker(dut) as (tap, tracker):
        tap.change(reading_command(tap), lambda reply: with_system_status(reply, SystemStatus.TEMPERATURE))
        refused(
            lambda: tracker.read_frame(PATIENT_S),
            DeviceError,
            "a reading from a unit that is too cold or too hot",
        )
        check(tracker.state is Lifecycle.HOLD, "state hold", tracker.state)
        tracker.read_frame(PATIENT_S)
        check(tracker.state is Lifecycle.ACTIVE, "state active when it has cleared", tracker.state)


@case("D43b", "on system status 0010 no more poses are used", needs=TAPPED)
def hardware_failure_is_a_fault(dut: DeviceUnderTest) -> None:
    with tapped_tracker(dut) as (tap, tracker):
        tap.change(
            reading_command(tap), lambda reply: with_system_status(reply, SystemStatus.HARDWARE_FAILURE)
        )
        refused(lambda: tracker.read_frame(PATIENT_S), DeviceError, "a reading from a faulty unit")
        check(tracker.state is Lifecycle.FAULT, "state fault", tracker.state)
