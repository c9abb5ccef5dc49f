"""Axis and position corrections: limits, monitors and sums."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from shared_controller import Make, on_a1

from sim.kuka.controller_parameters import ControllerParameters
from sim.world.scene.model import ArmTruth

A1_FULL_STEP_DEG = 360.0 * 0.004
QUARTER_DEG = A1_FULL_STEP_DEG / 4


def test_a_step_above_a_quarter_of_full_speed_stops_the_drives_and_moves_nothing(bench: Any) -> None:
    bench.enter_movecorr()
    bench.answer(on_a1(QUARTER_DEG + 0.001))
    assert bench.message_number == 1074
    assert not bench.controller.drives_on
    assert bench.controller.run is None
    assert bench.A1_deg == 0.0


def test_a_jump_of_the_correction_at_speed_ends_in_a_braked_stop(bench: Any) -> None:
    bench.enter_movecorr()
    value = 0.0
    for _ in range(50):
        value += 0.15
        bench.answer(on_a1(value))
    bench.answer(on_a1(value + 30.0))
    assert bench.message_number == 1074
    before, previous_step = bench.A1_deg, 0.15
    while bench.controller.moving:
        bench.controller.settle()
        step = bench.A1_deg - before
        assert -1e-9 <= step <= previous_step + 1e-9
        before, previous_step = bench.A1_deg, step
    assert before < value + 3.0


def test_speed_above_the_axis_limit_for_several_cycles_is_a_fault(make_bench: Make) -> None:
    bench = make_bench(parameters=ControllerParameters(step_share=2.0, acceleration_share=100.0))
    bench.enter_movecorr()
    for n in range(1, 3):
        bench.answer(on_a1(n * 1.5))
    bench.answer(on_a1(3.0))
    assert bench.controller.message is None  # two fast cycles only
    for n in range(1, 4):
        bench.answer(on_a1(3.0 + n * 1.5))
    assert bench.message_number == 1102


@pytest.mark.parametrize("cycle_ms", [4, 12])
@pytest.mark.parametrize("axis", range(6))
def test_a_lost_reply_at_working_speed_causes_no_acceleration_fault(
    make_bench: Make, cycle_ms: int, axis: int
) -> None:
    bench = make_bench(start=False)
    bench.controller.switch_drives(True)
    bench.controller.start(cycle_ms=cycle_ms)
    bench.enter_movecorr()
    joint = bench.controller.arm.description.joints[axis]
    step_deg, place = joint.full_speed_deg_s * cycle_ms / 1000 / 8, 0.0
    gain_deg = 0.2 * joint.acceleration_deg_s2 * (cycle_ms / 1000) ** 2  # a fifth of the axis acceleration
    speed = 0.0
    lost = 0
    for cycle in range(400):
        speed = min(step_deg, speed + gain_deg) if cycle < 300 else max(0.0, speed - gain_deg)
        place += speed
        if place > 90.0:
            break
        if speed == step_deg and cycle % 7 == 0:
            bench.miss()
            lost += 1
        else:
            bench.answer((0.0,) * axis + (-place,) + (0.0,) * (5 - axis))
    assert lost
    assert bench.controller.message is None


@pytest.mark.parametrize("lost", [3, 25])
def test_a_motion_resumes_at_speed_after_few_lost_replies_and_faults_after_many(
    make_bench: Make, lost: int
) -> None:
    bench = make_bench(parameters=ControllerParameters(step_share=1.0))
    bench.enter_movecorr()

    def on_a2(value: float) -> tuple[float, ...]:
        return (0.0, value, 0.0, 0.0, 0.0, 0.0)

    place, speed = 0.0, 0.0
    for _ in range(200):
        speed = min(0.15, speed + 0.0013)  # an eighth of full speed, at a fifth of the acceleration
        place -= speed
        bench.answer(on_a2(place))
    bench.miss(lost)
    if lost <= 3:
        for _ in range(100):
            place -= speed
            bench.answer(on_a2(place))
        assert bench.controller.message is None
    else:
        with pytest.raises(AssertionError):
            bench.ramp(on_a2(place - 100 * speed), on_a2(place), steps=100)
        assert bench.message_number == 1074


def test_sustained_excess_acceleration_is_a_fault_even_if_no_step_is_too_large(bench: Any) -> None:
    bench.enter_movecorr()
    A2_step_deg = 0.24 * 300.0 * 0.004
    with pytest.raises(AssertionError):
        bench.ramp((0.0, 60 * A2_step_deg, 0.0, 0.0, 0.0, 0.0), steps=60)
    assert bench.message_number == 1074
    assert "deg/s2" in bench.controller.message.text
    assert not bench.controller.drives_on


def test_the_default_context_clamps_at_the_software_end_switches(bench: Any) -> None:
    bench.enter_movecorr()
    bench.go(on_a1(175.0), steps=2000)
    assert bench.A1_deg == 170.0
    assert bench.controller.message is None
    assert bench.controller.run.correction_stats == (0b11, 0)


def test_a_context_without_limits_uses_the_narrow_vendor_defaults(
    make_bench: Make, context_with: Make
) -> None:
    bench = make_bench(context_with(axis_correction=None, axis_monitor=None))
    bench.enter_movecorr()
    bench.go(on_a1(8.0))
    assert bench.A1_deg == 5.0


def test_a_monitor_stops_a_correction_that_the_limits_let_pass(make_bench: Make, context_with: Make) -> None:
    bench = make_bench(context_with(axis_monitor=None))
    bench.enter_movecorr()
    with pytest.raises(AssertionError):
        bench.ramp(on_a1(8.0))
    assert bench.message_number == 29000
    assert bench.A1_deg < 6.5


def test_a_12_ms_cycle_allows_three_times_the_step(make_bench: Make) -> None:
    bench = make_bench(start=False)
    bench.controller.switch_drives(True)
    assert bench.controller.start(cycle_ms=12).code == 0
    first = bench.controller.run.ipoc
    bench.enter_movecorr()
    assert bench.controller.run.ipoc == first + 60
    bench.answer(on_a1(3 * QUARTER_DEG))
    assert bench.controller.message is None
    bench.answer(on_a1(6 * QUARTER_DEG + 0.001))
    assert bench.message_number == 1074


def position_bench(make_bench: Make, context_with: Make, truth: ArmTruth | None = None, **tables: Any) -> Any:
    context = context_with(**tables)
    places = {"A1": "X", "A2": "Y", "A3": "Z", "A4": "A", "A5": "B", "A6": "C"}
    wiring = tuple(
        wire.model_copy(update={"object": "POSCORR", "input": places[wire.input]})
        if wire.object == "AXISCORR"
        else wire
        for wire in context.wiring
    )
    return make_bench(context.model_copy(update={"wiring": wiring}), truth)


def test_a_cartesian_correction_moves_the_tool_in_base(make_bench: Make, context_with: Make) -> None:
    bench = position_bench(make_bench, context_with)
    bench.enter_movecorr()
    start = bench.controller.arm.frame
    goal = (2.0, -1.0, 3.0, 1.0, 0.0, 0.0)
    bench.go(goal)
    moved = [b - a for a, b in zip(start, bench.controller.arm.frame, strict=True)]
    assert moved[:3] == pytest.approx([2.0, -1.0, 3.0], abs=1e-4)
    assert (moved[3] + 180) % 360 - 180 == pytest.approx(1.0, abs=1e-4)
    assert bench.controller.run.correction_stats == (0, 1)


def test_cartesian_corrections_are_clamped_and_monitored(make_bench: Make, context_with: Make) -> None:
    bench = position_bench(make_bench, context_with)
    start = bench.controller.arm.frame
    bench.enter_movecorr()
    bench.go((8.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert bench.controller.arm.frame[0] - start[0] == pytest.approx(5.0, abs=1e-4)
    assert bench.controller.run.correction_stats == (0, 0b11)
    with pytest.raises(AssertionError):
        bench.ramp((8.0, 5.0, 0.0, 0.0, 0.0, 0.0), from_deg=(8.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert bench.message_number == 29000


def test_a_cartesian_correction_through_a_singularity_raises_a_wrist_velocity_fault(
    make_bench: Make, context_with: Make, perfect_arm: Make
) -> None:
    truth = perfect_arm(home_deg=(0.0, -80.0, 100.0, 20.0, 0.5, 0.0))
    bench = position_bench(make_bench, context_with, truth=truth)
    bench.enter_movecorr()
    with pytest.raises(AssertionError):
        bench.ramp((0.0, 0.0, 0.0, 2.0, 0.0, 0.0), steps=500)
    assert bench.message_number == 1102
    assert "singularity" in bench.controller.message.text
    seen = np.array([state.joints_rad for state in bench.published])
    full_step_deg = [joint.full_speed_deg_s * 0.004 for joint in bench.controller.arm.description.joints]
    assert (np.abs(np.degrees(np.diff(seen, axis=0))) <= full_step_deg).all()


def test_relative_cartesian_corrections_integrate(make_bench: Make, context_with: Make) -> None:
    bench = position_bench(make_bench, context_with, program={"corrections": "relative"})
    bench.enter_movecorr()
    start = bench.controller.arm.frame
    for _ in range(100):
        bench.answer((0.02, 0.0, -0.01, 0.0, 0.0, 0.0))
    bench.rest()
    moved = [b - a for a, b in zip(start, bench.controller.arm.frame, strict=True)]
    assert moved[:3] == pytest.approx([2.0, 0.0, -1.0], abs=1e-4)


@pytest.mark.parametrize(("reference", "direction"), [("Base", (1.0, 0.0, 0.0)), ("Tool", (-1.0, 0.0, 0.0))])
def test_corrections_refer_to_base_or_tool_as_configured(
    make_bench: Make, context_with: Make, reference: str, direction: tuple[float, ...]
) -> None:
    bench = position_bench(make_bench, context_with, position_correction={"reference": reference})
    bench.enter_movecorr()
    start = np.array(bench.controller.arm.frame[:3])
    bench.go((2.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    moved = np.array(bench.controller.arm.frame[:3]) - start
    assert moved == pytest.approx(2.0 * np.array(direction), abs=1e-4)
