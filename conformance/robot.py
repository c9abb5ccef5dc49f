"""Cases that every robot arm must pass, whatever its protocol.

Without `--allow motion` nothing moves: the stream starts with zero corrections, which hold the arm in place.
The motions of the suite are small and return to their start.
"""

from __future__ import annotations

import itertools
import math
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from math import degrees, radians
from typing import Any

from conformance.case import MOTION, NotShown, Suite, check, refused
from conformance.device_cases import (
    DeviceCases,
    Interruption,
    check_closing,
    check_connect_nowhere,
    check_early_calls,
    check_identity,
    check_interface,
    check_unknown_option,
    observe,
)
from conformance.device_under_test import DeviceUnderTest
from ronna_hw.arm.motion.limits import REDUCED_SPEED_FRACTION, REDUCED_SPEED_MM_S
from ronna_hw.devices.axis_loads import LOAD_CYCLES, AxisLoads, TellsLoads
from ronna_hw.devices.contact import INSERTION_SPEED_MM_S, Insertion, InsertsInstruments
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import ArmReading, Validity
from ronna_hw.devices.robot import JointMove, LineMove, OperatingMode, RobotArm, StopKind
from ronna_hw.errors import DataError, LimitError, RefusedError, RonnaError, StateError
from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform
from ronna_hw.vectors import JointVector

HOLDING_S = 0.2  # theatre time for which an arm with zero corrections is observed
LATE_PERIODS = 50  # fifths of `HOLDING_S` for which a late host may serve no cycle
STANDS_STILL_RAD = radians(0.001)  # ten of the last digits of the usual wire
REACHED_RAD = radians(0.01)  # after a settled joint move
REACHED_MM = 0.05  # after a settled straight line; repeatability of small arms is 0.03 mm
SMALL_TURN_RAD = radians(1.0)  # of the last axis: the hand turns, nothing else moves
STOPPED_TURN_RAD = radians(20.0)  # long enough to be stopped on the way
SMALL_LINE_MM = 2.0
SMALL_TILT_RAD = radians(5.0)  # of the hand about a point off the flange: 0.1 mm aside if that goes straight
BESIDE_FLANGE_MM = (100.0, 0.0, 50.0)
FORCE_LIMIT_N = 20.0
STEADY_LOAD = 2.0  # %, A or N: six times the noise of a mean of the coarsest signal, CB3's force (U)
ROUNDING = 1.0 + 1e-9
SLOW = 0.1  # of the driver's working speed: a person can follow it and press a button
CLOSE_LIMIT_S = 8.0  # the arm may have to come to rest first
CONNECT_LIMIT_S = 3.0


SUITE = Suite(
    "robot",
    driver="kuka_rsi",
    motions=(
        f"its last axis by {degrees(SMALL_TURN_RAD):g} deg, or {degrees(STOPPED_TURN_RAD):g} if a stop "
        f"fails, and its hand by {SMALL_LINE_MM:g} mm and {degrees(SMALL_TILT_RAD):g} deg, "
        f"at {SLOW:g} of the working speed, and back"
    ),
)


def turn_last_axis(joints_rad: JointVector, by_rad: float) -> JointVector:
    """Return the joint vector with the last axis turned towards zero."""
    a, b, c, d, e, last = joints_rad
    return (a, b, c, d, e, last - math.copysign(by_rad, last))


def active_arm(dut: DeviceUnderTest) -> tuple[Any, JointVector]:
    arm = dut.at(Lifecycle.ACTIVE)
    return arm, arm.read_state().commanded_rad


def axis_distance_rad(a: JointVector, b: JointVector) -> float:
    """Return the largest difference over all axes, rad."""
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def check_standstill(reading: ArmReading, joints_rad: JointVector) -> None:
    """Raise Nonconformity unless the arm has stayed at these joint angles."""
    moved = axis_distance_rad(reading.joints_rad, joints_rad)
    check(moved < STANDS_STILL_RAD, "an arm at standstill", f"{degrees(moved):.5f} deg")


SUITE.case("R01", "the driver implements RobotArm and starts disconnected")(
    partial(check_interface, interface=RobotArm)
)


SUITE.case("R02", "connecting identifies the device")(check_identity)


@SUITE.case("R03", "calls in the wrong state are refused")
def early_calls_are_refused(dut: DeviceUnderTest) -> None:
    arm = check_early_calls(
        dut,
        disconnected=("configure", "activate", "deactivate", "read_state", "read_tool_identity", "resume"),
        connected=("activate",),
    )
    here = arm.read_state().joints_rad
    refused(lambda: arm.move(JointMove(here)), StateError, "move while connected")


@SUITE.case("R04", "the axes can be read before the stream starts, and are plausible")
def state_is_readable(dut: DeviceUnderTest) -> None:
    reading: ArmReading = dut.at(Lifecycle.CONNECTED).read_state()
    check(reading.validity is Validity.OK, "validity ok", reading.validity)
    check(reading.commanded_rad is None, "no commanded axes without a stream", reading.commanded_rad)
    check(all(abs(angle) < math.tau for angle in reading.joints_rad), "axes within a turn", reading)


@SUITE.case("R05", "the mounted tool can be read, 0 for none")
def tool_is_readable(dut: DeviceUnderTest) -> None:
    check(dut.at(Lifecycle.CONNECTED).read_tool_identity().number >= 0, "a number of 0 or more")


@SUITE.case("R06", "starting the stream moves nothing: the first correction is zero")
def first_correction_is_zero(dut: DeviceUnderTest) -> None:
    arm = dut.at(Lifecycle.CONFIGURED)
    before = arm.read_state().joints_rad
    arm.activate()
    check(arm.state is Lifecycle.ACTIVE, "state active", arm.state)
    reading: ArmReading = arm.read_state()
    check(reading.commanded_rad is not None, "commanded axes while the stream runs")
    for _ in range(5):
        dut.clock.sleep(HOLDING_S / 5)
        reading = arm.read_state()
        check_standstill(reading, before)
        check(reading.commanded_rad is not None, "commanded axes while the stream runs")
        lag = axis_distance_rad(reading.joints_rad, reading.commanded_rad or reading.joints_rad)
        check(lag < STANDS_STILL_RAD, "commanded axes where the arm is", f"{degrees(lag):.5f} deg")


@SUITE.case("R07", "readings are numbered, times never go backwards, the device's clock advances")
def stamps_are_in_order(dut: DeviceUnderTest) -> None:
    arm = dut.at(Lifecycle.ACTIVE)
    before = arm.read_state().stamp
    for _ in range(5):
        await_cycle(dut, arm)
        after = arm.read_state().stamp
        check(after.sequence > before.sequence, "a later reading", after.sequence)
        check(after.theatre_time_s >= before.theatre_time_s, "a later theatre time", after.theatre_time_s)
        expected = f"a device clock after {before.device_clock}, as a cycle has come since"
        check(after.device_clock > before.device_clock, expected, after.device_clock)
        before = after


def await_cycle(dut: DeviceUnderTest, arm: RobotArm) -> None:
    """Wait until the link has served another cycle: a late host alone makes no clock stand still."""
    served = arm.link_statistics().cycles
    for _ in range(LATE_PERIODS):
        dut.clock.sleep(HOLDING_S / 5)
        link = arm.link_statistics()
        if link.cycles > served:
            return
    raise NotShown(
        f"no cycle of the link came for {LATE_PERIODS * HOLDING_S / 5:g} s, so no clock can be judged: this "
        f"computer or the controller is late ({link.late_cycles} late, {link.lost_cycles} lost cycles); "
        "repeat it on a quiet computer"
    )


@SUITE.case("R08", "the link statistics are consistent")
def statistics_agree(dut: DeviceUnderTest) -> None:
    arm = dut.at(Lifecycle.ACTIVE)
    dut.clock.sleep(HOLDING_S)
    s = arm.link_statistics()
    check(s.cycles > 0, "cycles while the stream runs", s.cycles)
    edges = s.histogram_edges_us
    check(len(edges) == len(s.histogram_counts) + 1, "one more edge than counts", len(edges))
    check(all(b > a for a, b in itertools.pairwise(edges)), "increasing edges")
    check(sum(s.histogram_counts) > 0, "turnarounds counted", s.histogram_counts)
    check(0 < s.turnaround_median_us <= s.turnaround_p99_us, "a median below the 99th percentile", s)


@SUITE.case("R09", "a speed fraction outside (0, 1] is refused before any motion")
def speed_fraction_is_checked(dut: DeviceUnderTest) -> None:
    arm, here = active_arm(dut)
    for fraction in (0.0, -0.5, 1.5, math.nan):
        refused(
            lambda fraction=fraction: arm.move(JointMove(here, speed_fraction=fraction)),  # type: ignore[misc]
            RonnaError,
            f"a speed fraction of {fraction}",
        )


@SUITE.case("R10", "the stream can be stopped and restarted without a jump")
def stop_and_start_again(dut: DeviceUnderTest) -> None:
    arm = dut.at(Lifecycle.ACTIVE)
    before = arm.read_state().joints_rad
    arm.deactivate()
    check(arm.state is Lifecycle.CONFIGURED, "state configured", arm.state)
    refused(lambda: arm.move(JointMove(before)), StateError, "move after deactivate")
    arm.activate()
    dut.clock.sleep(HOLDING_S)
    check_standstill(arm.read_state(), before)


@SUITE.case("R11", "a small joint move reaches its target, and the start again", needs=(MOTION,))
def small_joint_move(dut: DeviceUnderTest) -> None:
    arm, start = active_arm(dut)
    for target in (turn_last_axis(start, SMALL_TURN_RAD), start):
        reading: ArmReading = arm.move(JointMove(target, speed_fraction=SLOW))
        missed = axis_distance_rad(reading.joints_rad, target)
        check(missed < REACHED_RAD, "the target", f"{degrees(missed):.4f} deg off")
        check(not reading.moving, "an arm at rest")


@SUITE.case("R12", "a small straight line reaches its target, and the start again", needs=(MOTION,))
def small_line(dut: DeviceUnderTest) -> None:
    arm, start = active_arm(dut)
    here: Transform = arm.kinematics.flange_pose(start)
    for target in (here.displace((0.0, 0.0, SMALL_LINE_MM)), here):
        reading: ArmReading = arm.move(LineMove(target, speed_fraction=SLOW))
        reached: Transform = arm.kinematics.flange_pose(reading.joints_rad)
        missed_mm = math.dist(reached.translation_mm, target.translation_mm)
        check(missed_mm < REACHED_MM, "the target", f"{missed_mm:.4f} mm off")
    check(axis_distance_rad(arm.read_state().joints_rad, start) < REACHED_RAD, "the axes of the start")


@SUITE.case("R13", "a target outside the joint ranges is refused before any motion", needs=(MOTION,))
def target_out_of_range(dut: DeviceUnderTest) -> None:
    arm, here = active_arm(dut)
    outside = (*here[:-1], arm.kinematics.upper_rad[-1] + SMALL_TURN_RAD)
    refused(lambda: arm.move(JointMove(outside)), LimitError, "a target out of range")
    check(arm.state is Lifecycle.ACTIVE, "state active", arm.state)
    check_standstill(arm.read_state(), here)


@SUITE.case("R14", "hold stops the moving arm before its target; resume moves nothing", needs=(MOTION,))
def hold_comes_to_rest(dut: DeviceUnderTest) -> None:
    arm, start = active_arm(dut)
    ends = _stop_midway(dut, arm, start, StopKind.HOLD)
    check(any(isinstance(error, StateError) for error in ends), "a motion that says it was stopped", ends)
    check(arm.state is Lifecycle.HOLD, "state hold", arm.state)
    refused(lambda: arm.move(JointMove(start)), StateError, "move in hold")
    held = arm.read_state().commanded_rad
    arm.resume()
    check(arm.state is Lifecycle.ACTIVE, "state active", arm.state)
    check(arm.read_state().commanded_rad == held, "an arm that stays where it was held")
    target = turn_last_axis(start, STOPPED_TURN_RAD)
    check(axis_distance_rad(held, target) > SMALL_TURN_RAD, "an arm stopped before its target")
    arm.move(JointMove(start, speed_fraction=SLOW))


@SUITE.case("R15", "a protective stop is latched; recover clears it without motion", needs=(MOTION,))
def protective_stop_is_latched(dut: DeviceUnderTest) -> None:
    arm, start = active_arm(dut)
    ends = _stop_midway(dut, arm, start, StopKind.PROTECTIVE)
    check(bool(ends), "a motion that says it was stopped")
    check(arm.state is Lifecycle.FAULT, "state fault", arm.state)
    check(observe(arm, Lifecycle.FAULT).fault is not None, "the fault observed")
    refused(lambda: arm.move(JointMove(start)), StateError, "move in fault")
    arm.recover("conformance suite")
    check(arm.state is Lifecycle.CONFIGURED, "state configured", arm.state)
    arm.activate()
    arm.move(JointMove(start, speed_fraction=SLOW))


SUITE.case("R16", "closing ends in bounded time, is final and may be repeated")(
    lambda dut: check_closing(dut.at(Lifecycle.ACTIVE), CLOSE_LIMIT_S)
)


@SUITE.case("R17", "reconnecting opens a new connection to the same device, in the same pose")
def reconnecting_starts_afresh(dut: DeviceUnderTest) -> None:
    first = dut.make()
    identity = first.connect()
    before = dut.bring_to(Lifecycle.ACTIVE, first).read_state().joints_rad
    first.close()
    second = dut.make()
    again = second.connect()
    check(identity == again, f"the identity {identity}", again)
    check_standstill(dut.bring_to(Lifecycle.ACTIVE, second).read_state(), before)
    dut.release()


SUITE.case("R18", "connecting to an endpoint without a device fails in time, with code and advice")(
    partial(check_connect_nowhere, limit_s=CONNECT_LIMIT_S)
)


SUITE.case("R19", "an unknown option is refused by the constructor")(check_unknown_option)


@SUITE.case("R20", "a straight line to a pose between the wrong frames is refused before any motion")
def frames_of_a_line_are_checked(dut: DeviceUnderTest) -> None:
    arm = dut.at(Lifecycle.ACTIVE)
    before = arm.read_state().joints_rad
    here: Transform = arm.kinematics.flange_pose(before)
    tool = Transform.of(Frame.FLANGE, Frame.TOOL, translation_mm=BESIDE_FLANGE_MM)
    for target, flange_from_tool in (
        (here.inverse(), None),
        (here @ tool, None),
        (here, tool),
        (here @ tool, tool.inverse()),
    ):
        line = LineMove(target, flange_from_tool)
        for call in (partial(arm.move, line), partial(arm.preview, line)):
            refused(call, FRAME_MISMATCH, f"a line to {target.target} <- {target.source}")
    check(arm.state is Lifecycle.ACTIVE, "state active", arm.state)
    check_standstill(arm.read_state(), before)


@SUITE.case("R21", "with a tool, it is the tool point that follows the straight line", needs=(MOTION,))
def line_is_the_tools(dut: DeviceUnderTest) -> None:
    arm, start = active_arm(dut)
    tool = Transform.of(Frame.FLANGE, Frame.TOOL, translation_mm=BESIDE_FLANGE_MM)
    here: Transform = arm.kinematics.flange_pose(start) @ tool
    half = SMALL_TILT_RAD / 2.0
    tilt = Transform.of(Frame.TOOL, Frame.TOOL, quaternion_wxyz=(math.cos(half), 0.0, math.sin(half), 0.0))
    for target in (here @ tilt, here):
        # The tool point stays in place while the hand turns about it.
        seen = []
        with ThreadPoolExecutor(1) as pool:
            moving = pool.submit(arm.move, LineMove(target, tool, SLOW))
            while not moving.done():
                seen.append(arm.read_state().commanded_rad)
                dut.clock.sleep(HOLDING_S / 20)
            moving.result()
        for joints in [*seen, arm.read_state().commanded_rad]:
            at: Transform = arm.kinematics.flange_pose(joints) @ tool
            beside_mm = math.dist(at.translation_mm, here.translation_mm)
            check(beside_mm < REACHED_MM, "the tool on its line", f"{beside_mm:.4f} mm off")
        check(len(seen) > 0, "readings on the way", len(seen))
    check(axis_distance_rad(arm.read_state().joints_rad, start) < REACHED_RAD, "the axes of the start")


SUITE.cases.extend(DeviceCases(lambda arm: arm.read_state(), CLOSE_LIMIT_S).build_cases("R", 22))


@SUITE.case("R26", "a block left by an exception brings the moving arm to rest on its way", needs=(MOTION,))
def exception_stops_the_arm(dut: DeviceUnderTest) -> None:
    arm = dut.make()
    with suppress(Interruption), arm.active():
        start = arm.read_state().commanded_rad
        mover, ends = start_moving(dut, arm, start)
        raise Interruption
    rest: ArmReading = arm.read_state()
    mover.join()
    check(arm.state is Lifecycle.CONFIGURED, "state configured", arm.state)
    check(bool(ends), "a motion that says it was stopped")
    check(
        axis_distance_rad(rest.joints_rad, start) < STOPPED_TURN_RAD / 2, "an arm stopped before its target"
    )
    dut.clock.sleep(HOLDING_S)
    check_standstill(arm.read_state(), rest.joints_rad)
    with arm.active():
        arm.move(JointMove(start, speed_fraction=SLOW))


@SUITE.case("R27", "the arm states its limits for every operating mode")
def limits_are_stated(dut: DeviceUnderTest) -> None:
    arm = dut.at(Lifecycle.CONNECTED)
    now = arm.limits()
    check(now == arm.limits(arm.operating_mode), "by default the limits of the present mode", now)
    full = arm.kinematics.full_speed_rad_s
    for mode in OperatingMode:
        limits = arm.limits(mode)
        numbers = (*limits.speed_rad_s, *limits.acceleration_rad_s2, *limits.jerk_rad_s3)
        check(all(0.0 < value < math.inf for value in numbers), f"limits of each axis, {mode}", limits)
        lower, upper = limits.ranges(arm.kinematics)
        check(all(a < b for a, b in zip(lower, upper, strict=True)), "a range of each axis", limits)
    reduced = arm.limits(OperatingMode.REDUCED_SPEED)
    check(
        reduced.body_speed_mm_s <= REDUCED_SPEED_MM_S,
        f"at most {REDUCED_SPEED_MM_S:g} mm/s at reduced speed",
        reduced,
    )
    shares = [speed / most for speed, most in zip(reduced.speed_rad_s, full, strict=True)]
    check(max(shares) <= REDUCED_SPEED_FRACTION * ROUNDING, "at most a tenth of full axis speed", reduced)


@SUITE.case("R28", "a preview keeps to the stated limits, and a target within the margin has none")
def previews_keep_to_the_limits(dut: DeviceUnderTest) -> None:
    arm = dut.at(Lifecycle.CONNECTED)
    here = arm.read_state().joints_rad
    seen = arm.preview(JointMove(turn_last_axis(here, STOPPED_TURN_RAD)), start_rad=here)
    check(seen.largest_joint_speed_share <= 1.0 + 1e-6, "an axis within its speed", seen)
    _, upper = arm.limits().ranges(arm.kinematics)
    beyond = JointMove((*here[:-1], upper[-1] + STANDS_STILL_RAD))
    refused(lambda: arm.preview(beyond, start_rad=here), LimitError, "a target beyond the stated range")


def _stop_midway(dut: DeviceUnderTest, arm: Any, start: JointVector, kind: StopKind) -> list[RonnaError]:
    """Interrupt a motion with a stop; returns the errors raised by the motion."""
    mover, ends = start_moving(dut, arm, start)
    try:
        arm.stop(kind)
    finally:
        mover.join()
    return ends


def start_moving(
    dut: DeviceUnderTest, arm: Any, start: JointVector
) -> tuple[threading.Thread, list[RonnaError]]:
    """Turn the last axis in a new thread; returns once the arm has visibly moved.

    The list receives the errors that the motion raises.
    """
    ends: list[RonnaError] = []

    def move() -> None:
        try:
            arm.move(JointMove(turn_last_axis(start, STOPPED_TURN_RAD), speed_fraction=SLOW))
        except RonnaError as error:
            ends.append(error)

    mover = threading.Thread(target=move)
    mover.start()
    while mover.is_alive() and axis_distance_rad(arm.read_state().joints_rad, start) < SMALL_TURN_RAD:
        dut.clock.sleep(HOLDING_S / 20)
    return mover, ends


@SUITE.case("R29", "an insertion off its axis, too fast, or with a limit it cannot watch is refused")
def wrong_insertions_are_refused(dut: DeviceUnderTest) -> None:
    arm, start = active_arm(dut)
    if not isinstance(arm, InsertsInstruments):
        return
    inserting: Any = arm
    no_tool = Transform.of(Frame.FLANGE, Frame.TOOL)
    tool: Transform = inserting.kinematics.flange_pose(start) @ no_tool
    ahead, aside = (
        tool @ Transform.of(Frame.TOOL, Frame.TOOL, translation_mm=(x, 0.0, SMALL_LINE_MM))
        for x in (0.0, SMALL_LINE_MM)
    )
    refused(lambda: arm.insert(Insertion(aside, no_tool)), DataError, "an insertion off its axis")
    fast = Insertion(ahead, no_tool, speed_mm_s=2.0 * INSERTION_SPEED_MM_S)
    refused(lambda: arm.insert(fast), DataError, "an insertion that is too fast")
    if not arm.senses_force:
        limited = Insertion(ahead, no_tool, force_limit_N=FORCE_LIMIT_N)
        refused(lambda: arm.insert(limited), RefusedError, "a force limit that cannot be watched")
    check_standstill(inserting.read_state(), start)


@SUITE.case("R30", "signals of the load are fresh, finite, and unchanged at rest, or stated as missing")
def loads_are_steady_at_rest(dut: DeviceUnderTest) -> None:
    arm = dut.at(Lifecycle.ACTIVE)
    if not isinstance(arm, TellsLoads):
        return
    before, after = arm.read_loads(), arm.read_loads()
    signals = [_list_signals(before), _list_signals(after)]
    if before.validity is Validity.MISSING:
        check(not any(signals) and before.cycles == 0, "no number for a signal that is missing", before)
        return
    check(after.validity is Validity.OK and bool(signals[0]), "validity ok, with a signal", after)
    check(after.cycles >= LOAD_CYCLES, f"a mean over {LOAD_CYCLES} cycles", after.cycles)
    check(after.stamp.sequence > before.stamp.sequence, "a later reading", after.stamp.sequence)
    check(after.stamp.device_clock > before.stamp.device_clock, "a later device clock", after.stamp)
    check(all(map(math.isfinite, itertools.chain(*signals))), "finite numbers", after)
    changed = max(abs(b - a) for a, b in zip(*signals, strict=True))
    check(changed < STEADY_LOAD, f"means that differ by less than {STEADY_LOAD:g}", f"{changed:.3g}")


def _list_signals(loads: AxisLoads) -> list[float]:
    stated = (loads.current_percent, loads.current_A, loads.expected_current_A, loads.force_N)
    return [value for signal in stated if signal is not None for value in signal]
