"""Our script as the controller gets it: settings at its head, registers as agreed, and what it does."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator

import pytest
from urscript import RunningScript

from drivers.universal_robots.controller.script import render_script
from drivers.universal_robots.options import UrOptions, script_settings
from ronna_hw.arm.universal_robots import UR5, UR5E
from ronna_hw.wire.universal_robots import (
    ORDER_INPUT,
    RUN_INPUT,
    RUN_OUTPUT,
    SCRIPT_NAME,
    SEQUENCE_INPUT,
    SEQUENCE_OUTPUT,
    SET_POINT_INPUTS,
    STATE_OUTPUT,
    ScriptOrder,
    ScriptState,
)
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.kinematics import TrueKinematics
from sim.universal_robots.model import MODELS
from sim.universal_robots.programs.recognition import recognise
from sim.universal_robots.robot import Robot
from sim.universal_robots.variables import index

SETTINGS = script_settings(UrOptions())
SCRIPT = render_script(SETTINGS)


def test_every_setting_is_one_line_at_the_head() -> None:
    assert SCRIPT.startswith(f"def {SCRIPT_NAME}():\n")
    head = SCRIPT.partition("WAITING")[0]
    for name, value in SETTINGS._asdict().items():
        found = re.findall(rf"^  {name} = (\S+)$", head, re.MULTILINE)
        assert [round(float(text), 6) for text in found] == [round(value, 6)], name


def test_the_registers_are_those_of_the_vocabulary() -> None:
    used = {int(number) for number in re.findall(r"read_input_integer_register\((\d+)\)", SCRIPT)}
    assert {f"input_int_register_{number}" for number in used} == {SEQUENCE_INPUT, ORDER_INPUT, RUN_INPUT}
    read = re.findall(r"read_input_float_register\((\d+)\)", SCRIPT)
    assert tuple(f"input_double_register_{number}" for number in read) == SET_POINT_INPUTS
    written = {int(number) for number in re.findall(r"write_output_integer_register\((\d+),", SCRIPT)}
    outputs = {SEQUENCE_OUTPUT, STATE_OUTPUT, RUN_OUTPUT}
    assert {f"output_int_register_{number}" for number in written} == outputs
    for state in ScriptState:
        assert state is ScriptState.NONE or f"  {state.name} = {state.value}\n" in SCRIPT
    assert f'rtde_set_watchdog("{SEQUENCE_INPUT}", 10, "stop")' in SCRIPT


def test_the_script_is_short_plain_ascii() -> None:
    assert SCRIPT.isascii()
    assert SCRIPT.count("\n") < 80


def test_a_payload_is_set_only_where_it_is_given() -> None:
    assert "set_payload" not in SCRIPT
    assert "\n  set_payload(1.25)\n" in render_script(SETTINGS, ("set_payload(1.25)",))


class ScriptAndSimulator:
    """The script's text and the simulator's program for it, side by side with equal inputs."""

    def __init__(self, model: str) -> None:
        settings = script_settings(UrOptions(model=model))
        self.largest_step_rad = settings.LARGEST_STEP_RAD
        arm = MODELS[model]
        self.robot = Robot(arm, ControllerParameters(), TrueKinematics(arm))
        text = render_script(settings)
        self.set_point = self.robot.drives.target
        self.script = RunningScript(text, self.set_point)
        program = recognise(text, arm.cycle_s)
        self.program = program.steps(self.robot, program)
        self.simulated_goal = self.set_point
        self.robot.drives.servo = self._servo  # type: ignore[method-assign, assignment]

    def cycle(self, sequence: int, order: ScriptOrder, run: int) -> ScriptState:
        """Run both for a cycle; returns the state that both report."""
        values = self.robot.values
        self.script.integers, self.script.doubles = [sequence, order, run], self.set_point
        for name, value in zip(
            (SEQUENCE_INPUT, ORDER_INPUT, RUN_INPUT, *SET_POINT_INPUTS),
            (sequence, order, run, *self.set_point),
            strict=True,
        ):
            values[index(name)] = value
        self.script.cycle()
        next(self.program, None)
        simulated = {number: values[index(f"output_int_register_{number}")] for number in (24, 25, 26)}
        assert self.script.outputs == simulated
        assert self.script.goal == self.simulated_goal
        return ScriptState(simulated[25])

    def _servo(self, goal: list[float], _lag_s: float) -> None:
        self.simulated_goal = goal


def random_cycles(script: ScriptAndSimulator, seed: int, most: int = 250) -> Iterator[ScriptState]:
    """Yield the state after each cycle, until the script stops; set-points come late, or are too far."""
    draws = random.Random(seed)
    sequence = pause = 0
    order = ScriptOrder.STREAM
    for _ in range(most):
        pause = draws.randrange(14) if draws.random() < 0.02 else max(0, pause - 1)
        if not pause and draws.random() < 0.8:
            sequence = 0 if draws.random() < 0.01 else sequence + draws.choice((1, 1, 1, 2))
            step_rad = script.largest_step_rad * (1.1 if draws.random() < 0.003 else 0.9)
            script.set_point = [angle + draws.uniform(-step_rad, step_rad) for angle in script.set_point]
        if draws.random() < 0.003:
            order = ScriptOrder.END
        state = script.cycle(sequence, order, draws.randrange(1, 3))
        yield state
        if state not in (ScriptState.WAITING, ScriptState.STREAMING):
            return


@pytest.mark.parametrize("model", [UR5, UR5E])
def test_the_simulator_does_what_the_script_does(model: str) -> None:
    last = {[*random_cycles(ScriptAndSimulator(model), seed)][-1] for seed in range(100)}
    assert last >= {ScriptState.ENDED, ScriptState.STARVED, ScriptState.TOO_FAR}
