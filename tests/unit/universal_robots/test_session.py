"""Set-points of the RTDE process: start, losses, speed slider, and stops from both sides."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest
from rtde_stand import CYCLE_S, FAR, IN, LIMITS, RUN, SETTINGS, START, RtdeStand, moving, streaming

from drivers.universal_robots.realtime.packages import Cause, ControllerWord
from drivers.universal_robots.realtime.session import REPORT_CYCLES
from ronna_hw.arm_stream.losses import WINDOW_CYCLES
from ronna_hw.arm_stream.records import EndStream, LinkFault, MotionResult, StopOrder, StreamPhase

WORKING_STEP_RAD = max(LIMITS.speed_rad_s) * CYCLE_S
REST_CYCLES = 400
ROBOT_EMERGENCY_STOP, REDUCED, POWER_OFF, PAUSED = 7, 2, 3, 4


def cause_of(stand: RtdeStand) -> int:
    return ControllerWord.from_number(stand.session.controller_word).cause


def test_before_the_script_runs_nothing_but_the_number_of_the_session_is_sent() -> None:
    stand = RtdeStand()
    reply = stand.cycle()
    assert reply is not None
    assert IN.unpack(reply)[3:] == (0, 0, RUN, *START)
    assert stand.session.phase is StreamPhase.ARMED


def test_registers_of_an_earlier_script_start_nothing() -> None:
    stand = RtdeStand()
    stand.script_state, stand.script_run, stand.used = 2, RUN + 1, 500
    for _ in range(5):
        reply = stand.cycle()
        assert reply is not None
        assert IN.unpack(reply)[3] == 0
    assert stand.session.phase is StreamPhase.ARMED


def test_the_stream_starts_where_the_controller_holds_the_arm_and_moves_nothing() -> None:
    stand = streaming()
    assert stand.session.phase is StreamPhase.RUNNING
    stand.cycles(50)
    assert set(stand.goals) == {START}


def test_each_set_point_has_the_next_sequence_number() -> None:
    stand = moving()
    numbers = [IN.unpack(stand.cycle() or b"")[3] for _ in range(20)]
    assert numbers == list(range(numbers[0], numbers[0] + 20))


def test_a_motion_reaches_its_target_within_the_working_speed() -> None:
    stand = moving()
    stand.run()
    assert stand.session.result is MotionResult.DONE
    assert stand.goal == pytest.approx(FAR, abs=1e-9)
    assert stand.largest_step_rad < 1.001 * WORKING_STEP_RAD
    assert stand.session.state(real_time=False, locked=False).late == 0


@pytest.mark.parametrize("every", [7, 20])
def test_the_path_waits_for_set_points_that_came_late(every: int) -> None:
    stand = moving()
    for number in range(600):
        stand.is_late = number % every == 0
        stand.cycle()
    stand.is_late = False
    stand.run()
    assert stand.session.result is MotionResult.DONE
    assert stand.session.state(real_time=False, locked=False).late > 0
    assert stand.largest_step_rad < 2.01 * WORKING_STEP_RAD


def test_a_stall_of_the_computer_is_followed_by_a_start_from_rest() -> None:
    stand = moving()
    stand.cycle(lost=8)
    before = len(stand.goals)
    stand.cycles(3)
    steps = stand.goals[before - 2 :]
    assert max(abs(a[0] - b[0]) for a, b in itertools.pairwise(steps)) < 0.1 * WORKING_STEP_RAD
    stand.run()
    assert stand.session.result is MotionResult.DONE


def test_losing_half_of_the_set_points_for_long_stops_the_arm() -> None:
    stand = moving()
    for _ in range(800):
        stand.is_late = not stand.is_late
        stand.cycle()
        if stand.session.fault:
            break
    assert stand.session.fault is LinkFault.LOSSES


@pytest.mark.hazard(52)
@pytest.mark.parametrize("fraction", [0.0, 0.3])
def test_the_speed_slider_slows_the_path_and_at_zero_holds_it_until_it_is_raised(fraction: float) -> None:
    stand = moving()
    stand.fraction = fraction
    stand.cycles(REST_CYCLES)
    held = stand.goal
    stand.cycles(50)
    step = max(abs(a - b) for a, b in zip(held, stand.goal, strict=True)) / 50
    assert step == pytest.approx(fraction * WORKING_STEP_RAD, rel=0.02, abs=1e-12)
    assert stand.session.moving
    stand.fraction = 1.0
    stand.run()
    assert stand.session.result is MotionResult.DONE


@pytest.mark.hazard(52)
@pytest.mark.parametrize("lost", [4, 8])
def test_a_path_held_by_the_slider_at_zero_survives_lost_packages_and_a_script_that_stands(lost: int) -> None:
    stand = moving()
    stand.fraction = 0.0
    stand.cycles(REST_CYCLES)
    stand.cycle(lost=lost)
    stand.cycles(3)
    stand.is_replaced = True  # stands still: it uses no set-points
    stand.cycles(3 * WINDOW_CYCLES)
    assert stand.session.fault is LinkFault.NONE
    stand.is_replaced, stand.fraction = False, 1.0
    stand.run()
    assert stand.session.result is MotionResult.DONE


@pytest.mark.parametrize("scaling", [math.nan, -1.0, 1.5])
def test_a_speed_that_is_no_share_holds_the_arm(scaling: float) -> None:
    stand = moving()
    stand.scaling = scaling
    stand.cycles(REST_CYCLES)
    assert stand.session.state(real_time=False, locked=False).speed_share == 0.0


@pytest.mark.hazard(53)
@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"safety_mode": ROBOT_EMERGENCY_STOP}, Cause.SAFETY),
        ({"safety_mode": REDUCED}, Cause.SAFETY),
        ({"robot_mode": POWER_OFF}, Cause.ROBOT_MODE),
        ({"runtime_state": PAUSED}, Cause.PROGRAM),
        ({"script_state": 5}, Cause.SCRIPT),
    ],
)
def test_a_stop_by_the_controller_is_latched_in_its_cycle_and_nothing_is_sent_any_more(
    change: dict[str, int], cause: Cause
) -> None:
    stand = moving()
    for name, value in change.items():
        setattr(stand, name, value)
    assert stand.cycle() is None
    assert (stand.session.fault, cause_of(stand)) == (LinkFault.CONTROLLER, cause)
    for name in change:
        setattr(stand, name, getattr(streaming(), name))  # as if resumed at the pendant
    assert all(stand.cycle() is None for _ in range(20))
    assert not stand.session.moving


def test_a_safety_mode_that_is_not_that_of_the_limits_ends_the_start() -> None:
    stand = RtdeStand()
    stand.safety_mode = REDUCED
    stand.begin()
    assert (stand.session.fault, cause_of(stand)) == (LinkFault.CONTROLLER, Cause.SAFETY)
    assert stand.cycle() is None
    assert set(stand.goals) == {START}


@pytest.mark.hazard(54)
def test_another_script_in_our_registers_ends_the_stream() -> None:
    stand = moving()
    stand.inputs = (*stand.inputs[:2], RUN + 1, *stand.inputs[3:])
    assert stand.cycle() is None
    assert cause_of(stand) == Cause.OTHER_SCRIPT


@pytest.mark.hazard(54)
@pytest.mark.parametrize("is_moving", [True, False])
@pytest.mark.parametrize("after_cycles", [2, 12])
def test_another_program_in_place_of_ours_ends_the_stream_before_it_is_taken_for_an_arm_that_does_not_follow(
    is_moving: bool, after_cycles: int
) -> None:
    stand = moving() if is_moving else streaming()
    stand.is_replaced = True
    for cycle in range(1, 40):
        if cycle >= after_cycles:  # beyond what the monitor allows
            stand.measured = (stand.measured[0] + 0.001, *stand.measured[1:])
        if stand.cycle() is None:
            break
    assert (stand.session.fault, cause_of(stand)) == (LinkFault.CONTROLLER, Cause.OTHER_SCRIPT)
    assert cycle == SETTINGS.starved_cycles + REPORT_CYCLES + 1
    assert not stand.session.moving


def test_an_arm_that_does_not_follow_while_a_set_point_is_late_is_in_fault_once_one_is_used() -> None:
    stand = moving()
    stand.follows, stand.is_late = False, True
    stand.measured = (stand.measured[0] + 0.1, *stand.measured[1:])
    stand.cycles(2)
    stand.is_late = False
    stand.cycles(3)
    assert stand.session.fault is LinkFault.MONITOR


def test_a_link_stop_ceases_to_send_and_the_script_stops_the_arm() -> None:
    stand = moving()
    stand.stop(StopOrder.LINK)
    assert stand.cycle() is None
    stand.cycles(12)
    assert stand.script_state == 4


def test_a_program_that_ends_or_hangs_leaves_an_arm_at_rest_and_an_ended_script() -> None:
    for make_gone in ("is_parent_gone", "beats"):
        stand = moving()
        if make_gone == "beats":
            stand.beats = False
        else:
            stand.session.is_parent_gone = True
        stand.cycles(1500)
        assert stand.script_state == 3, make_gone
        assert stand.largest_step_rad < 1.3 * WORKING_STEP_RAD


@pytest.mark.hazard(30)
def test_a_program_that_freezes_after_another_fault_leaves_an_ended_script_and_the_first_fault() -> None:
    stand = moving()
    stand.stop(StopOrder.PROTECTIVE)
    stand.cycles(REST_CYCLES)
    assert stand.session.phase is StreamPhase.FAULT
    stand.cycles(2000)
    assert stand.script_state == 2, "the program lives, and may still acknowledge"
    stand.beats = False
    stand.cycles(600)
    assert stand.script_state == 3
    assert stand.session.fault is LinkFault.PROTECTIVE


@pytest.mark.parametrize("jump_s", [-1.0, 20.0])
def test_a_jump_of_the_controllers_time_ends_the_stream(jump_s: float) -> None:
    stand = moving()
    stand.timestamp_s += jump_s
    assert stand.cycle() is None
    assert stand.session.fault is LinkFault.RESTARTED


def test_joints_off_their_commanded_angles_at_the_start_are_refused() -> None:
    stand = RtdeStand()
    stand.follows = False
    stand.measured = (0.1, *START[1:])
    stand.begin()
    assert stand.session.fault is LinkFault.BASE


def test_ending_leaves_the_script_by_its_order() -> None:
    stand = streaming()
    stand.give(EndStream())
    stand.cycles(4)
    assert stand.script_state == 3
    assert stand.session.phase is StreamPhase.ENDING


def test_a_number_that_is_not_finite_is_rejected_before_the_start_and_trips_the_monitor_after_it() -> None:
    stand = RtdeStand()
    stand.goal = (math.nan, *START[1:])
    assert stand.cycle() is None
    assert stand.session.rejected == 1
    stand = streaming()
    stand.follows = False
    stand.measured = (math.nan, *START[1:])
    stand.cycles(2)
    assert stand.session.fault is LinkFault.MONITOR


def test_the_word_of_the_controller_survives_the_mailbox() -> None:
    for word in (ControllerWord(-1, 1, 2, 3, 4), ControllerWord(7, 13, 5, 0, 0)):
        assert ControllerWord.from_number(word.number) == word
        assert word.text


def test_reduced_limits_are_those_of_the_stream() -> None:
    from rtde_stand import MODEL

    reduced = LIMITS.with_reduced_speed(MODEL)
    stand = RtdeStand(limits=replace(reduced))
    stand.session.adopt(1, RUN, REDUCED)
    stand.safety_mode = REDUCED
    stand.begin()
    stand.move()
    stand.run(most=8000)
    assert stand.session.result is MotionResult.DONE
    assert stand.largest_step_rad < 1.001 * max(reduced.speed_rad_s) * CYCLE_S


def test_a_speed_that_is_no_number_is_new_in_each_package() -> None:
    stand = moving()
    assert stand.session.ready is not None
    stand.scaling = math.nan
    stand.cycles(3)
    assert stand.session.ready is None


def test_after_the_largest_number_of_a_set_point_no_reply_is_prepared() -> None:
    stand = moving()
    stand.is_replaced, stand.used = True, 2**31 - 1
    stand.cycle()
    assert stand.session.ready is None
