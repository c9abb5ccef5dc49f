"""POSCORR: pose corrections in base or tool, limited and monitored, also through a singularity."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ronna_hw.wire.kuka_context import RsiContext
from sim.world.scene.model import ArmTruth


def position_bench(
    make_bench: Callable[..., Any],
    context_with: Callable[..., RsiContext],
    truth: ArmTruth | None = None,
    **tables: Any,
) -> Any:
    context = context_with(**tables)
    places = {"A1": "X", "A2": "Y", "A3": "Z", "A4": "A", "A5": "B", "A6": "C"}
    wiring = tuple(
        wire.model_copy(update={"object": "POSCORR", "input": places[wire.input]})
        if wire.object == "AXISCORR"
        else wire
        for wire in context.wiring
    )
    return make_bench(context.model_copy(update={"wiring": wiring}), truth)


def test_a_cartesian_correction_moves_the_tool_in_base(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext]
) -> None:
    bench = position_bench(make_bench, context_with)
    bench.enter_movecorr()
    start = bench.controller.arm.frame
    goal = (2.0, -1.0, 3.0, 1.0, 0.0, 0.0)
    bench.ramp(goal)
    bench.rest(goal)
    moved = [b - a for a, b in zip(start, bench.controller.arm.frame, strict=True)]
    assert moved[:3] == pytest.approx([2.0, -1.0, 3.0], abs=1e-4)
    assert (moved[3] + 180) % 360 - 180 == pytest.approx(1.0, abs=1e-4)
    assert bench.controller.run.correction_stats == (0, 1)


def test_cartesian_corrections_are_clamped_and_monitored(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext]
) -> None:
    bench = position_bench(make_bench, context_with)
    start = bench.controller.arm.frame
    bench.enter_movecorr()
    bench.ramp((8.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    bench.rest((8.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert bench.controller.arm.frame[0] - start[0] == pytest.approx(5.0, abs=1e-4)
    assert bench.controller.run.correction_stats == (0, 0b11)
    with pytest.raises(AssertionError):
        bench.ramp((8.0, 5.0, 0.0, 0.0, 0.0, 0.0), from_deg=(8.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert bench.message_number == 29000


def test_a_cartesian_correction_through_a_singularity_raises_a_wrist_velocity_fault(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext], perfect_arm: Callable[..., Any]
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


def test_relative_cartesian_corrections_integrate(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext]
) -> None:
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
    make_bench: Callable[..., Any],
    context_with: Callable[..., RsiContext],
    reference: str,
    direction: tuple[float, ...],
) -> None:
    bench = position_bench(make_bench, context_with, position_correction={"reference": reference})
    bench.enter_movecorr()
    start = np.array(bench.controller.arm.frame[:3])
    bench.ramp((2.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    bench.rest((2.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    moved = np.array(bench.controller.arm.frame[:3]) - start
    assert moved == pytest.approx(2.0 * np.array(direction), abs=1e-4)
