"""Orders, commands, states, settings and histograms arrive unchanged between driver and real-time process."""

from __future__ import annotations

import os
from contextlib import closing
from dataclasses import replace

import pytest
from coded_errors import raises
from rsi_stand import SETTINGS

from drivers.kuka_rsi.realtime.settings import LinkSettings
from ronna_hw.arm.clearance.bodies import Capsule, Obstacle, Surroundings
from ronna_hw.arm.errors import SURROUNDINGS_TOO_LARGE
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.motion.progress import MOST_STEPS, PathLimits, SpeedStep
from ronna_hw.arm.pose import Pose
from ronna_hw.arm_stream.cycle_rows import read_cycles
from ronna_hw.arm_stream.mailbox import LONGEST_SURROUNDINGS_BYTES, RECORDER_CYCLES, Mailbox, MailboxTorn
from ronna_hw.arm_stream.records import (
    NO_STATE,
    Command,
    LinkFault,
    MotionResult,
    Move,
    OpenStream,
    Orders,
    RecordedCycle,
    StopOrder,
    StreamPhase,
)
from ronna_hw.arm_stream.statistics import EDGES_US, histogram_bin, percentile_us

SIX = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
STEP = SpeedStep(0.5, 0.2)


BALL = Obstacle("x" * 100, Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0))
PLAN = MotionPlan(SIX, SIX[::-1], PathLimits(0.1, 0.2, 0.3))


def test_a_fresh_mailbox_holds_no_state_and_no_command(mailbox: Mailbox) -> None:
    assert mailbox.read_state() == NO_STATE
    assert mailbox.read_command() is None
    assert mailbox.orders() == Orders(0, 0, 0)


@pytest.mark.parametrize("target", [None, Pose.from_kuka(1, 2, 3, 40, 50, 60)])
@pytest.mark.parametrize("steps", [(), (SpeedStep(0.0, 0.5), SpeedStep(0.25, 0.1)), (STEP,) * MOST_STEPS])
def test_a_command_arrives_unchanged_on_the_other_side(
    mailbox: Mailbox, memory: int, target: Pose | None, steps: tuple[SpeedStep, ...]
) -> None:
    with closing(Mailbox(memory)) as other:
        plan = replace(PLAN, target=target, tool_in_flange_mm=(7.0, 8.0, 9.0), speed_steps=steps)
        command = Command(5, Move(plan), 3, Surroundings(obstacles=(BALL,) * (1 + len(steps))))
        mailbox.write_command(command)
        assert other.orders().command_number == 5
        found = other.read_command()
        assert found == command
        assert other.read_command().surroundings is found.surroundings  # read once


def test_surroundings_too_large_for_the_mailbox_are_refused(mailbox: Mailbox) -> None:
    many = Surroundings(obstacles=(BALL,) * (LONGEST_SURROUNDINGS_BYTES // 100))
    with raises(SURROUNDINGS_TOO_LARGE, match="ARM-008"):
        mailbox.write_command(Command(1, Move(PLAN), 0, many))


@pytest.mark.hazard(51)
@pytest.mark.parametrize("reduced", [False, True])
def test_the_limits_of_the_operating_mode_arrive_unchanged(mailbox: Mailbox, reduced: bool) -> None:
    arm = kr6_r900("kr6_r900_sixx")
    limits = working_limits(arm, 0.08).with_reduced_speed(arm) if reduced else working_limits(arm, 0.08)
    command = Command(5, OpenStream(limits, SIX))
    mailbox.write_command(command)
    assert mailbox.read_command() == command


def test_a_state_arrives_unchanged(mailbox: Mailbox) -> None:
    state = replace(
        NO_STATE,
        cycles=7,
        device_clock=2**40,
        phase=StreamPhase.RUNNING,
        fault=LinkFault.MONITOR,
        result=MotionResult.STOPPED,
        degraded=True,
        settled=True,
        stop_number=4,
        foreign=3,
        foreign_host="192.168.10.30",
        measured_rad=SIX,
        violation_kind="jerk",
        violation_axis=6,
        violation_value=-0.5,
        errno=98,
    )
    mailbox.write_state(state)
    assert mailbox.read_state() == state


def test_stop_and_heartbeat_are_read_back_as_orders(mailbox: Mailbox) -> None:
    mailbox.write_heartbeat(9)
    mailbox.order_stop(2, StopOrder.LINK)
    assert mailbox.orders() == Orders(9, 2 * 8 + 3, 0)


def test_a_torn_block_is_never_read_as_a_state(memory: int, mailbox: Mailbox) -> None:
    mailbox.write_state(replace(NO_STATE, cycles=0xABCDEF))
    content = os.pread(memory, os.fstat(memory).st_size, 0)
    os.pwrite(memory, b"\0", content.find((0xABCDEF).to_bytes(8, "little")))
    with pytest.raises(MailboxTorn):
        mailbox.read_state()


def test_the_recorder_keeps_the_last_cycles_in_order(mailbox: Mailbox) -> None:
    for cycle in range(1, 301):
        mailbox.record(RecordedCycle(cycle, 4 * cycle, cycle, 10.0, SIX, SIX, cycle % 3))
    kept = mailbox.read_records()
    assert [r.cycle for r in kept] == list(range(45, 301))
    assert kept[-1] == RecordedCycle(300, 1200, 300, 10.0, SIX, SIX, 0)


def test_cycles_are_copied_once_each_and_none_that_the_writer_may_have_touched(mailbox: Mailbox) -> None:
    kept = RECORDER_CYCLES
    for cycle in range(1, kept + 10):
        mailbox.record(RecordedCycle(cycle, 4 * cycle, 100 * cycle, 10.0, SIX, SIX[::-1], 0))
    mailbox.write_state(replace(NO_STATE, cycles=kept + 8))  # that of the newest is not published yet
    first = read_cycles(mailbox, after_ns=0)
    assert first.received_ns.tolist() == [100 * cycle for cycle in range(10, kept + 9)]
    assert first.device_clock[-1] == 4 * (kept + 8)
    assert first.measured_rad[0].tolist() == list(SIX)
    assert first.commanded_rad[0].tolist() == list(SIX[::-1])
    mailbox.write_state(replace(NO_STATE, cycles=kept + 9))
    assert read_cycles(mailbox, after_ns=100 * (kept + 8)).received_ns.tolist() == [100 * (kept + 9)]


def test_link_settings_survive_a_json_round_trip() -> None:
    settings_given = replace(SETTINGS, send_tags=("a",), receive_tags=("b", "c"), keeps_bytes=True)
    assert LinkSettings.from_json(settings_given.to_json()) == settings_given


def test_each_turnaround_falls_between_the_edges_of_its_bin() -> None:
    for value in (0.1, 1.99, 2.0, 2.6, 10.0, 55.5, 4000.0, 1e6):
        k = histogram_bin(value)
        assert EDGES_US[k] <= value * 1.000001
        assert value < EDGES_US[k + 1] * 1.000001
    assert histogram_bin(1e12) == len(EDGES_US) - 2


def test_percentiles_lie_in_the_right_bin() -> None:
    counts = [0] * (len(EDGES_US) - 1)
    assert percentile_us(counts, 0.5) == 0.0
    counts[histogram_bin(10.0)] = 99
    counts[histogram_bin(1000.0)] = 1
    assert 8.0 < percentile_us(counts, 0.5) < 13.0
    assert 700.0 < percentile_us(counts, 0.999) < 1300.0
