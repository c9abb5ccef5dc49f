"""Our streaming script, carried out from its settings."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from ur_clients import script

from ronna_hw.wire.universal_robots import (
    ORDER_INPUT,
    RUN_INPUT,
    RUN_OUTPUT,
    SEQUENCE_INPUT,
    SEQUENCE_OUTPUT,
    SET_POINT_INPUTS,
    STATE_OUTPUT,
    RuntimeState,
    ScriptOrder,
    ScriptState,
)
from sim.universal_robots.controller import Controller
from sim.universal_robots.programs.recognition import recognise
from sim.universal_robots.variables import index

STEP_RAD = 0.001


class Stream:
    """A client of the script, without a link."""

    def __init__(self, controller: Controller, text: str | None = None) -> None:
        self.controller = controller
        self.values = controller.robot.values
        self.home = list(controller.robot.drives.target)
        self.sequence = 0
        self.put(0, self.home)
        self.refusal = controller.start(recognise(text or script(), controller.model.cycle_s))

    def put(self, sequence: int, joints_rad: list[float], order: ScriptOrder = ScriptOrder.STREAM) -> None:
        self.values[index(SEQUENCE_INPUT)], self.values[index(ORDER_INPUT)] = sequence, order
        first = index(SET_POINT_INPUTS[0])
        self.values[first : first + 6] = joints_rad

    def move(self, count: int, step_rad: float = STEP_RAD) -> None:
        """Send so many set-points, each used in the next cycle."""
        for _ in range(count):
            self.sequence += 1
            goal = [self.home[0] + self.sequence * step_rad, *self.home[1:]]
            self.put(self.sequence, goal)
            self.controller.step()
            assert self.values[index(SEQUENCE_OUTPUT)] == self.sequence

    def wait(self, cycles: int) -> None:
        for _ in range(cycles):
            self.controller.step()

    @property
    def state(self) -> ScriptState:
        return ScriptState(self.values[index(STATE_OUTPUT)])

    @property
    def at_rest(self) -> bool:
        return not self.controller.robot.drives.moving


@pytest.fixture
def stream(controller: Controller) -> Stream:
    return Stream(controller)


def test_it_waits_for_the_first_set_point_however_long_that_takes(stream: Stream) -> None:
    stream.values[index(RUN_INPUT)] = 77
    stream.wait(500)
    assert stream.state is ScriptState.WAITING
    assert stream.values[index(RUN_OUTPUT)] == 77
    assert stream.at_rest


def test_it_uses_each_set_point_in_the_next_cycle_and_lags_by_34_ms(stream: Stream) -> None:
    stream.move(200)
    speed_rad_s = STEP_RAD / stream.controller.model.cycle_s
    goal = stream.home[0] + 200 * STEP_RAD
    assert (goal - stream.controller.robot.drives.target[0]) / speed_rad_s == pytest.approx(0.034, abs=0.002)


def test_a_starved_script_stops_the_arm_and_ends_for_good(stream: Stream) -> None:
    stream.move(100)
    stream.wait(9)
    assert stream.state is ScriptState.STREAMING
    stream.wait(1)
    assert stream.state is ScriptState.STARVED
    assert not stream.at_rest
    stream.wait(100)
    assert stream.at_rest
    assert stream.controller.runtime_state is RuntimeState.STOPPED
    before = list(stream.controller.robot.drives.target)
    stream.put(stream.sequence + 1, stream.home)
    stream.wait(50)
    assert stream.controller.robot.drives.target == before


def test_a_set_point_too_far_from_the_last_stops_the_arm(stream: Stream) -> None:
    stream.move(50)
    stream.put(stream.sequence + 1, [stream.home[0] + 1.0, *stream.home[1:]])
    stream.wait(100)
    assert stream.state is ScriptState.TOO_FAR
    assert stream.at_rest
    assert abs(stream.controller.robot.drives.target[0] - stream.home[0]) < 0.1


def test_a_first_set_point_away_from_the_arm_moves_nothing(stream: Stream) -> None:
    stream.put(1, [stream.home[0] + 0.03, *stream.home[1:]])
    stream.wait(20)
    assert stream.state is ScriptState.TOO_FAR
    assert stream.controller.robot.drives.target == stream.home


def test_the_order_to_end_leaves_the_program(stream: Stream) -> None:
    stream.move(3)
    stream.put(stream.sequence, stream.home, ScriptOrder.END)
    stream.wait(100)
    assert stream.state is ScriptState.ENDED
    assert stream.controller.runtime_state is RuntimeState.STOPPED


def test_a_protective_stop_brakes_and_nothing_that_is_sent_moves_the_arm(stream: Stream) -> None:
    stream.move(100)
    stream.controller.protective_stop("test")
    stream.wait(100)
    stopped = list(stream.controller.robot.drives.target)
    assert stream.at_rest
    assert stream.controller.runtime_state is RuntimeState.PAUSED
    stream.put(stream.sequence + 1, stream.home)
    stream.wait(100)
    assert stream.controller.robot.drives.target == stopped


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("  GAIN = 1000\n", ""), "GAIN is not defined"),
        (("0.03", "0.01"), "LOOKAHEAD_S"),
        (("= 10.0", "= 1e"), "syntax error"),
    ],
)
def test_a_script_with_bad_settings_fails_at_once_with_a_runtime_exception(
    controller: Controller, change: tuple[str, str], why: str
) -> None:
    failures: list[str] = []
    controller.news.failure.append(lambda text, _line: failures.append(text))
    Stream(controller, script().replace(*change)).wait(2)
    assert why in failures[0]
    assert controller.runtime_state is RuntimeState.STOPPED


def test_the_watchdog_ends_a_program_whose_client_writes_too_rarely(controller: Controller) -> None:
    text = script(starved=1000).replace(
        "  while True", '  rtde_set_watchdog("input_int_register_24", 10, "stop")\n  while True'
    )
    stream = Stream(controller, text)
    writes = [0]
    controller.watched = lambda: writes[0]
    for _ in range(100):
        writes[0] += 1
        stream.move(1)
    stream.wait(50)
    assert stream.state is ScriptState.STREAMING
    stream.wait(51)
    assert controller.program is None


@pytest.mark.parametrize("setting", ["start=idle", "start=power_off"])
def test_no_program_starts_while_the_arm_cannot_move(make: Callable[..., Controller], setting: str) -> None:
    assert Stream(make(setting)).refusal
