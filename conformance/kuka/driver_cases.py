"""Cases for the driver of a KUKA controller, observed through a tap between the two.

The number of a case is L and a line of the protocol's checklist. The stream is tapped, and telegrams may be
delayed, as by a stalled computer; nothing is modified or invented.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

from conformance.case import DESTRUCTIVE, HOST_TIME, MOTION, CaseList, check, require_present
from conformance.device_under_test import DeviceUnderTest
from conformance.disturbed_line import DisturbedLine
from conformance.kuka.client import AXES, IPOC
from conformance.kuka.tap import PiecewiseLine, RsiTap, Traffic, wait_for
from conformance.robot import SLOW, SMALL_TURN_RAD, start_moving, turn_last_axis
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.robot import JointMove
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.host.network import own_udp_endpoint
from ronna_hw.vectors import JointVector
from ronna_hw.wire.kuka_context import load_context

TAPPED_PORT = 1  # of this process' loopback endpoints; the simulated controller sends to 0
CYCLES = 100
WINDOWS = 3  # of this many cycles
HELD = 5  # telegrams that arrive at once after a stall
LIMIT_S = 10.0
SILENCE_LIMIT_S = 0.25  # of the driver in host time, unless the theatre file sets another
SILENCE_SLACK_S = 1.5  # for a busy computer; both together are below the allowed silence of EKI
GATHERED_S = 0.05
LARGEST_STEP_SHARE = 0.25  # of the step at full axis speed; a controller may treat a larger one as a fault

_TYPE = re.compile(rb'<Sen Type="([^"]*)">')

CASES = CaseList()
case = CASES.case


@contextmanager
def tapped_arm(dut: DeviceUnderTest, **endpoints: str) -> Iterator[tuple[Any, RsiTap]]:
    """Yield a driver with a tap on its RSI link; `endpoints` replaces its other endpoints."""
    dut.release()
    ours, inside = dut.config.endpoints, own_udp_endpoint(TAPPED_PORT)
    with (
        RsiTap(parse_endpoint(ours["rsi"]), parse_endpoint(inside)) as tap,
        closing(dut.make_beside(endpoints={**ours, **endpoints, "rsi": inside})) as arm,
    ):
        yield arm, tap


@contextmanager
def streaming_arm(dut: DeviceUnderTest, **endpoints: str) -> Iterator[tuple[Any, RsiTap]]:
    """Yield a streaming driver with a tap on its RSI link."""
    with tapped_arm(dut, **endpoints) as (arm, tap):
        yield dut.bring_to(Lifecycle.ACTIVE, arm), tap


@contextmanager
def piecewise_arm(dut: DeviceUnderTest, gather_s: float) -> Iterator[tuple[Any, PiecewiseLine]]:
    """Yield a connected driver that receives EKI elements byte by byte or several at once."""
    dut.release()
    with PiecewiseLine(parse_endpoint(dut.config.endpoints["eki_project"])) as line:
        line.gather_s = gather_s
        with tapped_arm(dut, eki_project=line.endpoint) as (arm, _):
            arm.connect(LIMIT_S)
            yield arm, line


def read_corrections(reply: bytes) -> list[float]:
    """Read the six axis corrections of a reply, in deg."""
    context = load_context()
    tags = [str(context.find_wired_tag("AXISCORR", axis)) for axis in AXES]
    found = []
    for tag in tags:
        name, _, attribute = tag.partition(".")
        match = re.search(rf'<{name} [^>]*\b{attribute}="([^"]+)"'.encode(), reply)
        found.append(float(require_present(match, f"{tag} in the reply", reply[:80])[1]))
    return found


@case("L11", "every reply echoes the IPOC of its telegram")
def echoes_the_time_stamp(dut: DeviceUnderTest) -> None:
    with streaming_arm(dut) as (_, tap):
        heard = _await_exchanges(tap)
    check(
        set(_extract_stamps(heard.replies)) <= set(_extract_stamps(heard.telegrams)),
        "only IPOCs of telegrams",
    )


@case("L12", "one reply per telegram; after a stall only the newest is answered")
def one_reply_each(dut: DeviceUnderTest) -> None:
    with streaming_arm(dut) as (_, tap):
        # On a busy computer telegrams arrive in bursts, and only the newest is answered.
        unanswered = min(_count_unanswered(tap) for _ in range(WINDOWS))
        check(unanswered <= CYCLES // 4, "telegrams answered one by one", f"{unanswered} unanswered")
        _stall(tap)
        late = tap.take_traffic()
        replies = _extract_stamps(late.replies)
        answered = [stamp for stamp in _extract_stamps(late.telegrams[:HELD]) if stamp in replies]
        # A later scheduled telegram may have arrived so soon that it was the newest.
        newest = _extract_stamps(late.telegrams[HELD - 1 :])
        check(any(stamp in replies for stamp in newest), "an answer to the newest telegram")
        check(len(answered) <= HELD - 2, "no answers to those before it", f"{len(answered)} of {HELD}")


def _count_unanswered(tap: RsiTap) -> int:
    """Count the unanswered telegrams during `CYCLES` or more replies; none may be answered twice."""
    heard = _await_exchanges(tap)
    stamps = _extract_stamps(heard.replies)
    check(len(set(stamps)) == len(stamps), "no telegram answered twice")
    return len(set(_extract_stamps(heard.telegrams))) - len(stamps)


@case("L13", "every reply has the Type of the configuration")
def replies_have_the_type(dut: DeviceUnderTest) -> None:
    with streaming_arm(dut) as (_, tap):
        types = {
            match[1] for reply in _await_exchanges(tap).replies if (match := _TYPE.match(reply)) is not None
        }
    check(types == {load_context().ethernet.sentype.encode()}, load_context().ethernet.sentype, types)


@case("L29", "the first correction of every run is zero")
def first_correction_is_zero(dut: DeviceUnderTest) -> None:
    with tapped_arm(dut) as (arm, tap):
        for _ in range(2):
            tap.take_traffic()
            dut.bring_to(Lifecycle.ACTIVE, arm)
            first = _await_exchanges(tap).replies[0]
            check(not any(read_corrections(first)), "zero", read_corrections(first))
            arm.deactivate()


@case("L29b", "no correction step exceeds what a controller accepts", needs=(MOTION,))
def steps_are_small(dut: DeviceUnderTest) -> None:
    with streaming_arm(dut) as (arm, tap):
        start: JointVector = arm.read_state().commanded_rad
        tap.take_traffic()
        for target in (turn_last_axis(start, SMALL_TURN_RAD), start):
            arm.move(JointMove(target, speed_fraction=SLOW))
        replies = [read_corrections(reply) for reply in tap.take_traffic().replies]
        cycle_s = load_context().program.cycle_ms / 1000.0
        limits = [
            speed * math.degrees(1.0) * cycle_s * LARGEST_STEP_SHARE
            for speed in arm.kinematics.full_speed_rad_s
        ]
    check(len(replies) > CYCLES, "a motion over many cycles", len(replies))
    for before, after in itertools.pairwise(replies):
        for axis, limit, a, b in zip(AXES, limits, before, after, strict=True):
            check(abs(b - a) <= limit, f"{axis} to step at most {limit:.4f} deg", f"{abs(b - a):.4f}")


@case("L30", "silence of the controller is detected in time and latched", needs=(DESTRUCTIVE, HOST_TIME))
def silence_is_noticed(dut: DeviceUnderTest) -> None:
    dut.release()
    with (
        DisturbedLine(parse_endpoint(dut.config.endpoints["eki_project"])) as line,
        streaming_arm(dut, eki_project=line.endpoint) as (arm, tap),
    ):
        line.silence()  # otherwise the controller itself would report the end of the run
        tap.hold()
        limit_s = SILENCE_LIMIT_S + SILENCE_SLACK_S
        is_noticed = wait_for(lambda: arm.state is Lifecycle.FAULT, limit_s)
        check(is_noticed, f"state fault within {limit_s:g} s", arm.state)
        line.silence(False)
        tap.discard()


@case(
    "L30b",
    "a motion ended by silence does not resume when telegrams return",
    needs=(MOTION, DESTRUCTIVE, HOST_TIME),
)
def motion_ends_with_silence(dut: DeviceUnderTest) -> None:
    with streaming_arm(dut) as (arm, tap):
        start: JointVector = arm.read_state().commanded_rad
        mover, ends = start_moving(dut, arm, start)
        check(mover.is_alive(), "an arm that moves")
        tap.hold()
        mover.join()
        tap.take_traffic()
        tap.discard()  # whether or not the controller has ended the run by now
        wait_for(lambda: tap.replies >= HELD, SILENCE_SLACK_S)
        later = [tuple(read_corrections(reply)) for reply in tap.take_traffic().replies]
        check(len(ends) == 1, "a motion that reports why it ended", ends)
        check(len(set(later)) <= 1, "a constant correction from then on", later)
        arm.recover("conformance suite", LIMIT_S)
        arm.activate(LIMIT_S)
        arm.move(JointMove(start, speed_fraction=SLOW))


@case("L31", "late cycles by D and our own turnaround are reported")
def losses_are_reported(dut: DeviceUnderTest) -> None:
    with streaming_arm(dut) as (arm, tap):
        before = arm.link_statistics()
        tap.hold()
        dut.clock.sleep(2 * HELD * load_context().program.cycle_ms / 1000.0)
        tap.release()
        has_grown = wait_for(lambda: arm.link_statistics().late_cycles > before.late_cycles, LIMIT_S)
        check(has_grown, "late cycles in the statistics", arm.link_statistics().late_cycles)
        check(arm.link_statistics().turnaround_median_us > 0, "a turnaround")


@case("L38", "elements are delimited by their end tags, however the bytes arrive")
def elements_in_pieces(dut: DeviceUnderTest) -> None:
    for gather_s in (0.0, GATHERED_S):
        with piecewise_arm(dut, gather_s) as (arm, _):
            reading = arm.read_state()
            check(len(reading.joints_rad) == len(AXES), "six axes", reading)


@case("L40", "a lost connection is restored or latched, and the state is read again")
def connection_is_lost(dut: DeviceUnderTest) -> None:
    with piecewise_arm(dut, 0.001) as (arm, line):
        before = arm.read_state().joints_rad
        line.sent_data.clear()
        line.cut()

        def is_restored() -> bool:
            try:
                return bool(arm.read_state().joints_rad == before)
            except RonnaError:
                return arm.state is Lifecycle.FAULT

        check(wait_for(is_restored, LIMIT_S), "the same axes again, or a latched fault", arm.state)
        if arm.state is Lifecycle.FAULT:
            line.sent_data.clear()
            arm.recover("conformance suite", LIMIT_S)
        check(any(b"STATUS" in data for data in line.sent_data), "a new STATUS request", line.sent_data)
        check(arm.read_state().joints_rad == before, "the same axes", arm.read_state())


def _stall(tap: RsiTap) -> None:
    """Hold back `HELD` telegrams, release them in one burst, and wait for replies to flow again."""
    tap.hold()
    check(wait_for(lambda: tap.held_count >= HELD, LIMIT_S), f"{HELD} telegrams during a stall")
    tap.release()
    check(wait_for(lambda: tap.replies >= HELD, LIMIT_S), "answers after a stall")


def _await_exchanges(tap: RsiTap) -> Traffic:
    """Wait for at least `CYCLES` replies and return the traffic."""
    check(wait_for(lambda: tap.replies >= CYCLES, LIMIT_S), f"{CYCLES} replies")
    return tap.take_traffic()


def _extract_stamps(datagrams: list[bytes]) -> list[int]:
    return [int(match[1]) for data in datagrams if (match := IPOC.search(data)) is not None]
