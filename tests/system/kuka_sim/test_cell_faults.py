"""Every fault of arm and cell, by script and live, and what a client sees of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import pairwise

import pytest
from kuka_clients import Cell
from kuka_stage import Stage, on_a1, rests_at

from ronna_hw.host.control_port import ask_control_port
from sim.theatre.scene.named_scenes import named_scene
from sim.theatre.world import World

STOPS = [
    ("emergency stop for 0.2 s", {"EStop": "1", "Drives": "0", "Err": "1"}, {"EStop": "0"}),
    ("guard open for 0.2 s", {"Guard": "1", "Drives": "0", "Err": "6"}, {"Guard": "0"}),
    ("mode T2 for 0.2 s", {"Mode": "T2", "Drives": "0", "Err": "0"}, {"Mode": "EXT"}),
    ("drives off", {"Drives": "0", "Err": "0"}, {}),
    ("collision", {"Drives": "0", "Err": "117"}, {}),
]


@pytest.mark.parametrize(("fault", "during", "after"), STOPS, ids=[stop[0] for stop in STOPS])
def test_a_stop_of_the_robot_is_told_by_eki_and_the_arm_stands_while_rsi_streams(
    stage: Stage, fault: str, during: dict[str, str], after: dict[str, str]
) -> None:
    stage.move(3.0, cycles=50)
    stage.inject(fault)
    stage.rsi.cycles(40, on_a1(3.5))
    stage.eki.until(lambda e: all(e.get(key) == value for key, value in during.items()))
    resting_deg = stage.rsi.axes_deg
    stage.rsi.cycles(40, on_a1(4.0))
    assert stage.rsi.axes_deg == resting_deg
    state = stage.eki.state(**after, RSI="1")
    assert state.get("ProState") == "P_STOP"
    assert stage.eki.command("RSI_START") == 4
    assert stage.eki.command("RSI_STOP") == 0
    assert stage.rsi.quiet(0.1)
    if during.get("Err", "0") != "0":
        assert stage.eki.command("RSI_START") == 1
        assert stage.eki.command("ACK_ERRORS") == 0
    assert stage.eki.command("RSI_START") == 5  # the drives are off
    assert stage.eki.command("DRIVES", On=1) == 0
    assert stage.eki.command("RSI_START") == 0


def test_while_the_emergency_stop_is_pressed_nothing_can_be_switched_on_or_acknowledged(
    stage: Stage,
) -> None:
    stage.inject("emergency stop")
    stage.rsi.cycles(5)
    assert stage.eki.command("DRIVES", On=1) == 5
    assert stage.eki.command("ACK_ERRORS") == 5
    status = stage.sdk().read().find("Status")
    assert status is not None
    told = ("DrivesPowered", "EmergencyStop", "GuardStop", "MotionPossible", "RobotStopped")
    assert [status.get(name) for name in told] == ["0", "1", "0", "0", "1"]


def test_in_T1_corrections_need_the_start_key_a_confirmation_and_the_enabling_switch(stage: Stage) -> None:
    assert stage.eki.command("RSI_STOP") == 0
    stage.inject("mode T1")
    stage.eki.state(Mode="T1", Moving="0")
    assert stage.eki.command("DRIVES", On=1) == 0
    assert stage.eki.command("RSI_START") == 1
    assert stage.eki.command("PTP_AXIS", A1=0, A2=-90, A3=90, A4=0, A5=80, A6=0) == 1
    stage.inject("mode T1", "start key held")
    stage.rsi.forget()
    stage.eki.until_command("RSI_START", 0)
    stage.rsi.cycles(20)
    assert stage.eki.state(Id="8").get("RSI") == "1"
    assert stage.eki.command("ACK_ERRORS") == 0
    stage.rsi.cycles(5)
    assert stage.eki.state(Id="8").get("RSI") == "2"
    stage.inject("mode T1", "start key held", "enabling switch released")
    stage.rsi.cycles(20)
    state = stage.eki.state(Drives="0")
    assert (state.get("Err"), state.get("RSI")) == ("26", "1")
    assert stage.eki.command("DRIVES", On=1) == 5


def test_in_T1_the_tool_is_stopped_above_250_mm_per_second(stage: Stage) -> None:
    assert stage.eki.command("RSI_STOP") == 0
    stage.inject("mode T1", "start key held")
    stage.eki.state(Mode="T1", Moving="0")
    stage.rsi.forget()
    assert stage.eki.command("DRIVES", On=1) == 0
    stage.eki.until_command("RSI_START", 0)
    stage.rsi.cycles(10)
    assert stage.eki.command("ACK_ERRORS") == 0
    stage.rsi.cycles(10)
    stage.move(3.0, cycles=300)  # a few mm/s
    stage.rsi.cycles(50, on_a1(3.0))
    assert stage.eki.state(Id="8").get("Err") == "0"
    for n in range(1, 200):  # a gentle start to 45 deg/s at more than 400 mm
        if not stage.rsi.try_cycle(on_a1(3.0 + 0.18 * n * min(1.0, n / 60))):
            break
    assert stage.eki.state(RSI="3").get("Err") == "421"


def test_an_overload_stop_is_not_told_and_the_measured_axes_stop_following(stage: Stage) -> None:
    base_deg = stage.rsi.axes_deg[0]
    stage.move(3.0)
    stage.rsi.cycles(60, on_a1(3.0))
    stage.inject("overload")
    stage.move(6.0, begin_deg=3.0)
    assert stage.rsi.axes_deg[0] == pytest.approx(base_deg + 3.0, abs=1e-4)
    state = stage.eki.state(Id="8")
    assert (state.get("RSI"), state.get("Err"), state.get("Drives")) == ("2", "0", "1")
    assert stage.eki.command("RSI_STOP") == 0
    stage.eki.state(RSI="0", Moving="0")
    stage.rsi.forget()
    assert stage.eki.command("RSI_START") == 0
    stage.rsi.cycles(10)
    stage.move(1.0)
    assert rests_at(stage, 1.0, base_deg + 3.0)


@pytest.mark.parametrize(
    ("name", "number", "drives"),
    [("monitor", "29000", "1"), ("torque", "1073", "0"), ("end_switch", "1205", "1")],
)
def test_a_trip_ends_the_run_with_its_message_until_it_is_acknowledged(
    stage: Stage, name: str, number: str, drives: str
) -> None:
    stage.move(3.0, cycles=50)
    stage.inject(f"trip {name}")
    while stage.rsi.try_cycle(on_a1(3.0)):
        pass
    state = stage.eki.state(RSI="3", Moving="0")
    assert (state.get("Err"), state.get("Drives"), state.get("ProState")) == (number, drives, "P_STOP")
    assert stage.eki.command("RSI_START") == 1
    assert stage.eki.command("ACK_ERRORS") == 0


def test_clamped_corrections_hold_the_arm_while_the_run_goes_on(stage: Stage) -> None:
    base_deg = stage.rsi.axes_deg[0]
    stage.move(2.0)
    stage.rsi.cycles(60, on_a1(2.0))
    stage.inject("clamp 0.5 deg")
    stage.move(4.0, begin_deg=2.0)
    assert rests_at(stage, 4.0, base_deg - 1.5)
    assert stage.eki.state(Id="8").get("Err") == "0"
    stage.move(2.0, begin_deg=4.0)
    stage.world.set_fault_script("")
    assert rests_at(stage, 2.0, base_deg)


def test_a_sticking_axis_moves_by_fits_and_starts_and_lags_behind(stage: Stage) -> None:
    base_deg = stage.rsi.axes_deg[0]
    smooth = stage.move(1.0, cycles=500)
    stage.rsi.cycles(60, on_a1(1.0))
    stage.inject("stick axis 1 for 100 s")
    sticking = stage.move(2.0, cycles=500, begin_deg=1.0)
    assert sum(a == b for a, b in pairwise(sticking)) > 200
    assert sum(a == b for a, b in pairwise(smooth)) < 100
    stage.rsi.cycles(60, on_a1(2.02))
    behind_deg = base_deg + 2.02 - stage.rsi.axes_deg[0]
    assert 0.001 < abs(behind_deg) <= 0.051
    stage.world.set_fault_script("")
    assert rests_at(stage, 2.02, base_deg)


def test_a_restarted_program_has_another_port_other_stamps_and_the_present_pose_as_its_base(
    stage: Stage,
) -> None:
    base_deg, source, stamp = stage.rsi.axes_deg[0], stage.rsi.source, stage.rsi.ipoc
    stage.move(4.0, cycles=60)
    stage.inject("program restart")
    stage.rsi.until_other_source(source)
    assert abs(stage.rsi.ipoc - stamp) > 4 * 1000
    assert stage.rsi.late == 0
    reached_deg = stage.rsi.axes_deg[0]
    assert 3.0 < reached_deg - base_deg < 4.5
    stage.rsi.answer()
    stage.rsi.cycles(20)
    assert stage.rsi.axes_deg[0] == reached_deg


def test_both_channels_tell_a_live_emergency_stop_as_their_next_word(
    new_cell: Callable[..., Cell],
) -> None:
    cell = new_cell()
    eki, sdk = cell.project(), cell.sdk()
    sdk.read()
    eki.read()
    ask_control_port(cell.child.ready["control"], "fault", line="now: robot emergency stop")
    told = [eki.read().get("EStop") for _ in range(6)]
    # What was under way, what was due every 100 ms on a machine that stalls, and the change.
    assert "1" in told
    status = sdk.read().find("Status")
    assert status is not None
    assert status.get("EmergencyStop") == "1"


def test_a_controller_may_end_rsi_with_a_stop_and_fall_silent(
    world: World, new_cell: Callable[..., Cell]
) -> None:
    cell = new_cell("--set", "streams_after_stop=false", world=world)
    eki, rsi = cell.project(), cell.rsi
    cell.start(eki)
    rsi.cycles(20)
    world.set_fault_script(f"at {world.clock.now_s():.6f} s: robot emergency stop for 0.1 s")
    assert rsi.quiet(0.2)
    state = eki.state(RSI="3")
    assert (state.get("Err"), state.get("ProState")) == ("1", "P_STOP")
    world.clock.sleep(0.2)
    eki.state(EStop="0")
    assert eki.command("ACK_ERRORS") == 0


@pytest.fixture
def world() -> Iterator[World]:
    world = World.create(named_scene("mini", seed=5), paced=False)
    yield world
    world.clock.close()


@pytest.fixture
def new_cell() -> Iterator[Callable[..., Cell]]:
    with ExitStack() as stack:
        yield lambda *options, world=None: Cell(stack, *options, world=world)
