"""Replies and telegrams lost on the way, with a controller that holds the last correction it took."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import degrees
from typing import Literal

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rsi_stand import FAR, LIMITS, MODEL, NUMBERS, SETTINGS, START, START_DEG

from drivers.kuka_rsi.errors import STREAM_ERRORS
from drivers.kuka_rsi.fault_errors import RsiFaults
from drivers.kuka_rsi.options import KukaOptions
from drivers.kuka_rsi.realtime.link_health import Losses
from drivers.kuka_rsi.realtime.session import RsiSession
from drivers.kuka_rsi.realtime.telegram import Telegram
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose
from ronna_hw.arm_stream.losses import WINDOW_CYCLES
from ronna_hw.arm_stream.records import (
    Choice,
    Command,
    LinkFault,
    LinkState,
    MotionResult,
    Move,
    OpenStream,
    Orders,
    Request,
    StopOrder,
)
from ronna_hw.vectors import JointVector
from ronna_hw.wire.kuka_eki import OperationMode

CYCLE_MS = 4
FULL_STEP_DEG = [degrees(speed) * CYCLE_MS / 1000 for speed in MODEL.full_speed_rad_s]
WORKING_SHARE = 0.12
TAKEN_SHARE = 0.25  # of a full-speed step: what a controller takes in one cycle
ROUNDING = 1.001
JOINT_MOVE = plan_joint_move(MODEL, START, FAR, LIMITS)
AT_SPEED = 150  # cycles after which the motion runs at full working speed

Loss = Literal["", "reply", "telegram"]
LOSSES = st.lists(st.sampled_from(["", "", "", "reply", "telegram"]), min_size=1, max_size=120)


class HoldingController:
    """Controller that takes what arrives and keeps it otherwise; `tells` a loss so many telegrams late."""

    def __init__(self, tells: int | None = 0) -> None:
        self.session = RsiSession(SETTINGS)
        self._tells = tells
        self._cycle = 0
        self._commands = 0
        self._command: Command | None = None
        self.stop_word = 0
        self.late = [0, 0]  # the count as of each cycle's begin
        self.taken: list[JointVector] = [(0.0,) * 6]  # the corrections that act, one per cycle
        self.sent: list[JointVector] = []
        self.session.execute_command(self._new(OpenStream(LIMITS)))
        for _ in range(3):
            self.cycle()

    def move(self, plan: MotionPlan = JOINT_MOVE) -> None:
        self._command = self._new(Move(plan))
        self.cycle()

    def lose(self, losses: Sequence[Loss]) -> None:
        for loss in losses:
            self.cycle(loss)

    def stop(self) -> None:
        self.stop_word = ((self.stop_word >> 3) + 1) * 8 + StopOrder.HOLD

    def cycle(self, loss: Loss = "") -> None:
        self._cycle += 1
        held, late = self.taken[-1], self.late[-1]
        if loss != "telegram":
            a, b, c, d, e, f = (s + v for s, v in zip(START_DEG, held, strict=True))
            shown = 0 if self._tells is None else self.late[-1 - self._tells]
            ipoc = str(CYCLE_MS * (1000 + self._cycle)).encode()
            head = self.session.answer(
                Telegram((a, b, c, d, e, f), shown, ipoc),
                Orders(self._cycle, self.stop_word, self._commands),
                1_000_000_000 + self._cycle * CYCLE_MS * 1_000_000,
            )
            assert head is not None
            A1, A2, A3, A4, A5, A6 = (float(v) for v in NUMBERS.findall(head))
            self.sent.append((A1, A2, A3, A4, A5, A6))
            self.session.finish_cycle(self._command)
        if not loss:
            held = self.sent[-1]
        self.taken.append(held)
        self.late.append(late + bool(loss))

    def finish(self) -> None:
        """Cycles without loss until the motion has a result."""
        for _ in range(3000):
            if self.session.result is not MotionResult.RUNNING:
                return
            self.cycle()
        raise AssertionError("no result")

    @property
    def state(self) -> LinkState:
        return self.session.state(real_time=False, locked=False)

    @property
    def largest_share(self) -> float:
        """Largest step that acted, over the full-speed step of its axis."""
        return max(
            abs(y - x) / full
            for a, b in pairwise(self.taken)
            for x, y, full in zip(a, b, FULL_STEP_DEG, strict=True)
        )

    @property
    def end_deg(self) -> JointVector:
        a, b, c, d, e, f = (s + v for s, v in zip(START_DEG, self.taken[-1], strict=True))
        return (a, b, c, d, e, f)

    def _new(self, request: Request) -> Command:
        self._commands += 1
        return Command(self._commands, request, self.stop_word >> 3)


def _moving(cycles: int = AT_SPEED, tells: int | None = 0) -> HoldingController:
    controller = HoldingController(tells)
    controller.move()
    controller.lose([""] * cycles)
    return controller


def _whole() -> list[JointVector]:
    """Return what acts, cycle by cycle, when nothing is lost."""
    controller = _moving(0)
    controller.finish()
    return controller.taken


def _arrived(controller: HoldingController) -> bool:
    session = controller.session
    there = tuple(degrees(angle) for angle in FAR)
    assert (session.result, session.fault, session.violation) == (MotionResult.DONE, LinkFault.NONE, None)
    return controller.end_deg == pytest.approx(there, abs=2e-6)


# Replies that are told as lost in the next telegram


@pytest.mark.hazard(18)
@pytest.mark.parametrize("neighbours", [1, 2, 3])
def test_the_path_is_delayed_by_one_cycle_for_each_lost_reply(neighbours: int) -> None:
    whole = _whole()
    controller = _moving()
    controller.lose(["reply"] * neighbours)
    at = len(controller.taken) - neighbours
    controller.finish()
    assert controller.taken == whole[:at] + [whole[at - 1]] * neighbours + whole[at:]
    assert _arrived(controller)
    assert controller.state.late == neighbours


@pytest.mark.hazard(18)
@pytest.mark.parametrize("neighbours", [4, 5, 30])
def test_a_motion_restarts_from_rest_after_more_than_three_consecutive_lost_replies(neighbours: int) -> None:
    controller = _moving()
    held = controller.taken[-1]
    controller.lose(["reply"] * neighbours)
    controller.cycle()
    assert controller.session.choice is Choice.HOLD
    assert controller.taken[-1] == held  # the arm stood there, not one point further
    controller.cycle()
    assert max(abs(y - x) for x, y in zip(held, controller.taken[-1], strict=True)) < 1e-3
    controller.finish()
    assert controller.largest_share <= WORKING_SHARE * ROUNDING
    assert _arrived(controller)


@pytest.mark.hazard(18)
def test_more_than_three_lost_replies_in_a_second_halve_the_speed_until_four_clean_seconds() -> None:
    controller = _moving(100)
    for lost in range(1, 5):
        assert not controller.state.degraded
        controller.lose(["reply", ""])
        assert controller.state.late == lost
        controller.lose([""] * 3)
    assert controller.state.degraded
    controller.lose([""] * 60)  # jerk-limited braking to half the speed
    slowed = len(controller.taken)
    controller.finish()
    del controller.taken[:slowed]
    assert controller.largest_share <= WORKING_SHARE / 2 * ROUNDING
    controller.lose([""] * 1000)
    assert not controller.state.degraded


@pytest.mark.hazard(18)
@settings(max_examples=12, deadline=None)
@given(before=st.integers(0, AT_SPEED), losses=LOSSES)
def test_every_executed_step_is_one_prepared_step_whatever_is_lost(before: int, losses: list[Loss]) -> None:
    controller = _moving(before)
    controller.lose(losses)
    controller.finish()
    assert controller.largest_share <= WORKING_SHARE * ROUNDING
    assert _arrived(controller)


@pytest.mark.slow
@pytest.mark.hazard(18)
@settings(max_examples=60, deadline=None)
@given(before=st.integers(0, AT_SPEED), losses=LOSSES)
def test_every_executed_step_is_one_prepared_step_in_more_examples(before: int, losses: list[Loss]) -> None:
    test_every_executed_step_is_one_prepared_step_whatever_is_lost.hypothesis.inner_test(before, losses)


def test_a_point_too_far_from_the_held_one_is_not_sent_again() -> None:
    controller = _moving()
    points = controller.session._points
    assert points is not None
    points.monitor.limits = replace(points.monitor.limits, step_rad=(1e-6,) * 6)
    held = controller.taken[-1]
    controller.lose(["reply", ""])
    assert controller.taken[-1] == held
    assert controller.session.fault is LinkFault.MONITOR
    controller.lose([""] * 5)
    assert not controller.session.moving
    assert controller.taken[-1] == held


@settings(max_examples=12, deadline=None)
@given(before=st.integers(1, 200), losses=LOSSES)
def test_a_stop_during_lost_replies_is_smooth_and_ends_at_rest(before: int, losses: list[Loss]) -> None:
    here = MODEL.forward(START)
    x, y, z = here.position_mm
    line = Pose((x - 40, y + 60, z - 40), here.rotation)
    controller = HoldingController()
    controller.move(plan_line(MODEL, START, line, LIMITS, (0.0, 0.0, 200.0)))
    controller.lose([""] * before)
    controller.stop()
    controller.lose(losses)
    controller.lose([""] * 150)
    assert not controller.session.moving
    assert controller.session.fault is LinkFault.NONE
    assert controller.largest_share <= WORKING_SHARE * ROUNDING
    assert len(set(controller.taken[-20:])) == 1


# Telegrams that never came


@pytest.mark.hazard(18)
@pytest.mark.parametrize("gap", [1, 3])
def test_a_lost_telegram_is_not_a_lost_reply_even_though_the_controller_counts_it(gap: int) -> None:
    whole = _whole()
    controller = _moving()
    at = len(controller.taken)
    controller.lose(["telegram"] * gap)
    controller.cycle()
    # The last reply acted before the gap: the path goes on from it, and nothing is sent twice.
    assert controller.session.choice is Choice.GO
    assert controller.taken[at - 1 :] == [whole[at - 1]] * (gap + 1) + [whole[at]]


@pytest.mark.hazard(18)
def test_a_reply_lost_just_before_a_gap_is_sent_again_after_it() -> None:
    whole = _whole()
    controller = _moving()
    at = len(controller.taken)
    controller.lose(["reply", "telegram", ""])
    assert controller.session.choice is Choice.REPEAT
    assert controller.taken[at - 1 :] == [whole[at - 1]] * 3 + [whole[at]]
    controller.cycle()
    assert controller.taken[-1] == whole[at + 1]


# Controllers that tell late, or never


@pytest.mark.hazard(18)
@settings(max_examples=15, deadline=None)
@given(before=st.integers(0, AT_SPEED), losses=LOSSES)
@example(before=AT_SPEED, losses=["reply"] * 4)
@example(before=AT_SPEED, losses=["reply"] * 30)
def test_at_most_two_prepared_steps_act_at_once_when_losses_are_reported_one_telegram_late(
    before: int, losses: list[Loss]
) -> None:
    controller = _moving(before, tells=1)
    controller.lose(losses)
    controller.finish()
    assert controller.largest_share <= 2 * WORKING_SHARE * ROUNDING < TAKEN_SHARE
    assert _arrived(controller)


@pytest.mark.slow
@pytest.mark.hazard(18)
@settings(max_examples=100, deadline=None)
@given(before=st.integers(0, AT_SPEED), losses=LOSSES)
def test_at_most_two_prepared_steps_act_at_once_in_more_examples(before: int, losses: list[Loss]) -> None:
    once = test_at_most_two_prepared_steps_act_at_once_when_losses_are_reported_one_telegram_late
    once.hypothesis.inner_test(before, losses)


def test_a_controller_that_never_reports_losses_gets_the_path_as_planned() -> None:
    controller, undisturbed = _moving(tells=None), _moving(tells=None)
    controller.lose(["reply", "", "reply", "reply", ""])
    undisturbed.lose([""] * 5)
    assert controller.sent == undisturbed.sent
    assert controller.state.late == 0


# The counts


def test_a_delay_count_higher_than_the_gap_means_that_the_last_reply_was_not_taken() -> None:
    losses = Losses(CYCLE_MS)
    said = []
    for ipoc, delay in ((0, 5), (4, 5), (8, 6), (12, 7), (16, 7), (28, 9), (36, 11), (52, 11), (56, 11)):
        losses.count(ipoc, delay)
        said.append((losses.reply_lost, losses.held_cycles))
    assert said == [
        (False, 0),
        (False, 0),
        (True, 1),
        (True, 2),
        (False, 0),
        (False, 2),  # two telegrams missing, both counted
        (True, 4),  # one missing, two counted
        (False, 3),  # three missing, none counted: as if the last one had been taken
        (False, 0),
    ]


# Sustained loss


@pytest.mark.hazard(18)
def test_losing_half_of_the_replies_for_seconds_stops_the_arm_and_names_the_cause() -> None:
    controller = _moving()
    for _ in range(2 * WINDOW_CYCLES):
        controller.lose(["reply", ""])
        if controller.session.fault:
            break
    assert controller.session.fault is LinkFault.LOSSES
    controller.lose(["reply", ""] * 100)
    assert not controller.session.moving
    assert controller.largest_share <= WORKING_SHARE * ROUNDING
    error = RsiFaults("robot.master", kr6_r900(KukaOptions().variant), STREAM_ERRORS, KukaOptions()).error(
        controller.state, OperationMode.EXT
    )
    assert error.code == STREAM_ERRORS.unusable.code
    assert "late or lost by the controller's count" in str(error)


@pytest.mark.parametrize("every", [5, 8])
def test_a_motion_arrives_with_up_to_a_fifth_of_all_replies_lost(every: int) -> None:
    controller = _moving()
    while controller.session.result is MotionResult.RUNNING:
        controller.lose(["reply", *[""] * (every - 1)])
    assert _arrived(controller)


def test_a_single_stall_of_half_a_second_does_not_make_the_link_unusable() -> None:
    losses = Losses(CYCLE_MS)
    losses.count(0, 0)
    assert losses.count(CYCLE_MS * 126, 125) == 125
    for k in range(127, 1000):
        losses.count(CYCLE_MS * k, 125)
        assert not losses.is_unusable


def test_lost_cycles_at_rest_are_counted_and_stop_nothing() -> None:
    controller = HoldingController()
    controller.lose(["reply", ""] * 600)
    assert controller.session.fault is LinkFault.NONE
    assert controller.state.late == 600
