"""Every question that no public source settles has named parameters that change the behaviour."""

from __future__ import annotations

import time
from dataclasses import fields
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import reference_tables
from shared_controller import Make, on_a1

from ronna_hw.wire.kuka_context import RsiContext, load_context
from ronna_hw.wire.kuka_eki import OperationMode, RsiState
from sim.kuka.autostart import Autostart
from sim.kuka.command import kuka
from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.eki.project_channel import ProjectChannel
from sim.kuka.rsi.telegrams import ReplyReader
from sim.world.scene.model import ArmTruth
from sim.world.true_arm import TrueArm

# Ways of the simulation alone, about which nobody could tell anything on a real controller.
OF_THE_SIMULATION = {
    "first_request_s",  # of our own program on the controller
    "rest_error_deg",
    "reversal_deg",
    "motion_speed_deg_s",
    "stick_breakaway_deg",
    "line_acceleration_mm_s2",
    "line_turn_rad_s",
}
WIDE_DEG = (400.0,) * 6


@pytest.fixture
def bench_with(make_bench: Make) -> Make:
    def make(context: RsiContext | None = None, cycle_ms: int | None = None, **parameters: Any) -> Any:
        bench = make_bench(context, parameters=ControllerParameters(**parameters), start=False)
        bench.controller.switch_drives(True)
        assert bench.controller.start(cycle_ms=cycle_ms).code == 0
        return bench

    return make


def test_every_open_question_names_existing_parameters_and_options() -> None:
    parameters = {entry.name for entry in fields(ControllerParameters)}
    options = {f"--{name.replace('_', '-')}" for name in kuka.__annotations__}
    context = load_context()
    for one in reference_tables.read_questions():
        assert list(one.answers), one.question
        assert set(one.parameters) <= parameters
        assert set(one.scene) <= set(ArmTruth.model_fields)
        assert set(one.options) <= options
        for name in one.context:
            table, key = name.split(".")
            assert hasattr(getattr(context, table), key)


def test_every_parameter_answers_a_question_or_belongs_to_the_simulation_alone() -> None:
    asked = {name for one in reference_tables.read_questions() for name in one.parameters}
    assert asked | OF_THE_SIMULATION == {entry.name for entry in fields(ControllerParameters)}
    assert not asked & OF_THE_SIMULATION


# -- drives


def test_the_12_ms_filter_smooths_corrections_and_settles_exactly_on_them(bench_with: Make) -> None:
    behind = {}
    for cycle_ms, filter_s in ((12, 0.0), (12, 0.05), (4, 0.05), (4, 0.0001)):
        bench = bench_with(cycle_ms=cycle_ms, ipo_filter_s=filter_s)
        bench.enter_movecorr()
        for _ in range(6):
            bench.answer(on_a1(0.3))
        behind[cycle_ms, filter_s] = 0.3 - bench.controller.arm.axes_deg[0]
        bench.rest(on_a1(0.3))
        assert bench.controller.arm.axes_deg[0] == 0.3
    assert behind[12, 0.05] > behind[12, 0.0] + 0.05
    assert behind[4, 0.05] == behind[4, 0.0001]


def test_axes_are_reported_in_readout_steps_but_held_exactly(bench_with: Make) -> None:
    bench = bench_with(readout_step_deg=0.01)
    bench.enter_movecorr()
    bench.go(on_a1(1.2345))
    assert b'<AIPos A1="1.2300"' in bench.telegram()
    assert bench.controller.arm.axes_deg[0] == 1.2345
    fine = bench_with(readout_step_deg=0.0)
    fine.enter_movecorr()
    fine.go(on_a1(1.2345))
    assert b'<AIPos A1="1.2345"' in fine.telegram()


@pytest.mark.parametrize(("answer", "rests_deg"), [("stop", None), ("clamp", 170.0)])
def test_a_software_end_switch_stops_the_arm_or_clamps_the_correction(
    bench_with: Make, context_with: Make, answer: str, rests_deg: float | None
) -> None:
    context = context_with(
        axis_correction={"limits": "explicit", "lower_deg": (-400.0,) * 6, "upper_deg": WIDE_DEG},
        axis_monitor={"limits": "explicit", "max_deg": WIDE_DEG},
    )
    bench = bench_with(context, at_end_switch=answer)
    bench.enter_movecorr()
    if rests_deg is None:
        with pytest.raises(AssertionError):
            bench.ramp(on_a1(175.0), steps=2000)
        assert bench.controller.message.number == ControllerParameters().end_switch_message
        assert bench.controller.message.text.startswith("software end switch +A1")
        return
    bench.go(on_a1(175.0), steps=2000)
    assert bench.controller.arm.axes_deg[0] == rests_deg
    bench.go(on_a1(165.0), from_deg=on_a1(175.0), steps=200)
    assert (bench.controller.arm.axes_deg[0], bench.controller.message) == (165.0, None)


# -- telegrams


def test_the_ipoc_starts_at_its_set_value_and_wraps_at_its_bit_width(bench_with: Make) -> None:
    stamps: dict[int, list[int]] = {32: [], 64: []}
    for bits, seen in stamps.items():
        bench = bench_with(ipoc_start=2**32 - 8, ipoc_bits=bits)
        for _ in range(4):
            seen.append(bench.controller.run.ipoc)
            bench.answer()
        assert bench.controller.run.late == 0
    assert stamps[32] == [2**32 - 8, 2**32 - 4, 0, 4]
    assert stamps[64] == [2**32 - 8, 2**32 - 4, 2**32, 2**32 + 4]


@pytest.mark.parametrize(
    ("tells", "lag", "said"),
    [
        ("total", 0, [0, 1, 2, 2, 3]),
        ("total", 1, [0, 0, 1, 2, 2]),
        ("in_a_row", 0, [0, 1, 2, 0, 1]),
        ("nothing", 0, [0, 0, 0, 0, 0]),
    ],
)
def test_delay_d_counts_late_replies_as_configured(
    bench_with: Make, tells: str, lag: int, said: list[int]
) -> None:
    bench = bench_with(delay_tells=tells, delay_lag_cycles=lag)
    bench.enter_movecorr()
    seen = []
    for answered in (False, False, True, False, True):
        seen.append(int(bench.telegram().split(b'<Delay D="')[1].split(b'"')[0]))
        bench.answer() if answered else bench.miss()
    assert seen == said


def test_stat_reports_limits_only_when_configured(bench_with: Make, context_with: Make) -> None:
    for tells, stats in ((True, (0b11, 0)), (False, (0b1, 0))):
        bench = bench_with(context_with(axis_correction=None, axis_monitor=None), stat_tells_limits=tells)
        bench.enter_movecorr()
        bench.ramp(on_a1(8.0))
        assert bench.controller.run.correction_stats == stats


# -- replies


@pytest.mark.parametrize(("lacking", "value"), [("holdon", 1.0), ("kept", 1.0), ("zero", 0.0)])
def test_values_missing_from_a_reply_are_held_or_zeroed(bench_with: Make, lacking: str, value: float) -> None:
    bench = bench_with(missing_element=lacking, step_share=10.0)
    bench.enter_movecorr()
    bench.go(on_a1(1.0))
    run = bench.controller.run
    for _ in range(40):
        reply = run.read(f'<Sen Type="KROSHU"><IPOC>{run.ipoc}</IPOC></Sen>'.encode())
        bench.controller.finish_cycle(reply)
    assert bench.controller.arm.axes_deg[0] == pytest.approx(value, abs=1e-3)
    bench.miss(20)  # without a reply HOLDON decides, whatever the parameter says
    assert bench.controller.arm.axes_deg[0] == pytest.approx(value, abs=1e-3)


def test_exponents_and_bad_numbers_are_read_as_configured() -> None:
    context = load_context()
    reply = '<Sen Type="KROSHU"><AK A1="{}"/><IPOC>8</IPOC></Sen>'

    def read(text: str, **parameters: Any) -> float | str | None:
        reader = ReplyReader(context.receive, "KROSHU", ControllerParameters(**parameters))
        found = reader.read(reply.format(text).encode())
        return "none" if found is None else found.values[1]

    assert read("1.5e-1") == 0.15
    assert read("1.5e-1", reads_exponents=False) == "none"
    assert read("1.5", reads_exponents=False) == 1.5
    for bad in ("nan", "inf", "one", "1e999"):
        assert read(bad) == "none"
        assert read(bad, bad_number="missing") is None


# -- the run


def test_telegrams_can_start_with_movecorr_and_nothing_is_late_before_that(bench_with: Make) -> None:
    bench = bench_with(streams_from="movecorr", movecorr_after_cycles=10)
    run = bench.controller.run
    first = run.ipoc
    bench.miss(9)
    assert (run.streams, run.ipoc, run.late) == (False, first, 0)
    bench.miss()
    assert (run.streams, run.ipoc, run.state) == (True, first, RsiState.MOVECORR)
    bench.go(on_a1(1.0))
    assert bench.controller.arm.axes_deg[0] == 1.0


def test_in_t1_telegrams_can_wait_for_the_confirmation(make_bench: Make) -> None:
    bench = make_bench(parameters=ControllerParameters(streams_from="movecorr"), start=False)
    bench.controller.turn_key(OperationMode.T1)
    bench.controller.hold_start_key(True)
    bench.controller.switch_drives(True)
    bench.controller.start()
    bench.miss(500)
    assert not bench.controller.run.streams
    bench.controller.acknowledge()
    bench.miss()
    assert bench.controller.run.streams


def test_corrections_may_act_from_the_first_telegram(bench_with: Make) -> None:
    moved = {}
    for act in ("movecorr", "rsi_on"):
        bench = bench_with(corrections_act=act, movecorr_after_cycles=50)
        for n in range(1, 30):
            bench.answer(on_a1(0.01 * n))
        assert bench.controller.rsi_state is RsiState.ON
        moved[act] = bench.controller.arm.axes_deg[0]
    assert moved["movecorr"] == 0.0
    assert moved["rsi_on"] > 0.1


@pytest.mark.parametrize(("scales", "reached"), [(False, 2.0), (True, 1.0)])
def test_the_override_may_scale_corrections(make_bench: Make, scales: bool, reached: float) -> None:
    bench = make_bench(parameters=ControllerParameters(override_scales_corrections=scales), start=False)
    bench.controller.switch_drives(True)
    bench.controller.set_override(50)
    bench.controller.start()
    bench.enter_movecorr()
    bench.go(on_a1(2.0))
    assert bench.controller.arm.axes_deg[0] == reached


@pytest.mark.parametrize("cancels", [False, True])
def test_a_lost_eki_connection_may_end_the_run(bench_with: Make, cancels: bool) -> None:
    bench = bench_with(eki_loss_cancels=cancels)
    bench.enter_movecorr()
    bench.controller.handle_eki_loss()
    assert (bench.controller.run is None) is cancels


class Heard:
    """An EKI channel that keeps what the program says."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.connected = True
        self.silent = False

    def attach(self, _peer: object) -> None:
        pass

    def send(self, text: str) -> None:
        self.texts.append(text)

    def drop(self) -> None:
        self.connected = False


def _ask(bench: Any, request: str) -> list[ElementTree.Element]:
    heard: Any = Heard()
    channel = ProjectChannel(heard, bench.controller, Autostart(bench.controller, is_requested=False))
    channel.request(ElementTree.fromstring(request))
    return [ElementTree.fromstring(text) for text in heard.texts]


@pytest.mark.parametrize("asks", [False, True])
def test_a_client_that_sends_no_request_loses_the_channel(make_bench: Make, asks: bool) -> None:
    bench = make_bench(parameters=ControllerParameters(first_request_s=3.0), start=False)
    heard: Any = Heard()
    channel = ProjectChannel(heard, bench.controller, Autostart(bench.controller, is_requested=False))
    channel.client_connected()
    if asks:
        channel.request(ElementTree.fromstring('<Cmd Id="1" Name="STATUS"></Cmd>'))
    channel.request(ElementTree.fromstring("<Tea/>"))
    now_s = time.monotonic()
    channel.tick(now_s + 2.0)
    assert heard.connected
    heard.silent = True  # a program that hangs reads no request, and disconnects nobody
    channel.tick(now_s + 4.0)
    assert heard.connected
    heard.silent = False
    channel.tick(now_s + 4.0)
    assert heard.connected is asks


@pytest.mark.parametrize("inverted", [0, 2, 7])
def test_inverted_status_bits_apply_when_reported_and_when_received(make_bench: Make, inverted: int) -> None:
    bench = make_bench(parameters=ControllerParameters(inverted_status=inverted), start=False)
    bench.controller.switch_drives(True)
    home_deg = list(bench.controller.arm.axes_deg)
    position = _ask(bench, '<Cmd Id="3" Name="STATUS"></Cmd>')[0].find("Pos")
    assert position is not None
    assert int(position.attrib["S"]) == 0b010 ^ inverted
    said = " ".join(f'{name}="{value}"' for name, value in position.attrib.items())
    acknowledged = _ask(bench, f'<Cmd Id="4" Name="PTP_POS" {said}></Cmd>')[0]
    assert acknowledged.get("Code") == "0"
    while bench.controller.moving:
        bench.controller.settle()
    assert bench.controller.arm.axes_deg == pytest.approx(home_deg, abs=1e-3)


def test_a_text_is_cut_at_the_longest_krl_string(make_bench: Make) -> None:
    bench = make_bench(parameters=ControllerParameters(longest_text=10), start=False)
    acknowledged = _ask(bench, f'<Cmd Id="{"7" * 30}" Name="NONSENSE"></Cmd>')[0]
    assert acknowledged.get("Id") == "7" * 10
    assert acknowledged.get("Text") == "unknown co"


# -- the true arm


def test_thermal_drift_grows_with_time_in_motion_and_is_zero_when_cold(perfect_arm: Make) -> None:
    warm = TrueArm(perfect_arm(thermal_drift_mm=0.04, thermal_time_s=1000.0), seed=3)
    joints, flanks = (0.0, -1.3, 1.4, 0.0, 0.9, 0.0), (0.0,) * 6
    cold = warm.moving(joints, flanks, 0.0)
    away_mm = [
        float(np.linalg.norm(warm.moving(joints, flanks, moved_s)[:3, 3] - cold[:3, 3]))
        for moved_s in (0.0, 1000.0, 1e6)
    ]
    assert away_mm == pytest.approx([0.0, 0.04 * (1.0 - np.exp(-1.0)), 0.04], abs=1e-6)
    assert perfect_arm().thermal_drift_mm == 0.0  # results must not depend on the time before them


def test_a_warm_arm_grows_alike_in_all_directions_from_its_base(perfect_arm: Make) -> None:
    warm = TrueArm(perfect_arm(thermal_growth=1.2e-4, thermal_time_s=1000.0), seed=3)
    joints, flanks = (0.3, -1.3, 1.4, 0.0, 0.9, 0.0), (0.0,) * 6
    cold, hot = (warm.moving(joints, flanks, moved_s) for moved_s in (0.0, 1e6))
    assert hot[:3, 3] == pytest.approx(cold[:3, 3] * (1.0 + 1.2e-4), abs=1e-9)
    assert hot[:3, :3] == pytest.approx(cold[:3, :3], abs=1e-12)


def test_a_joint_is_held_at_the_nearest_step_of_its_encoder(perfect_arm: Make) -> None:
    exact, coarse = (TrueArm(perfect_arm(encoder_step_rad=step_rad), seed=3) for step_rad in (0.0, 1e-4))
    joints, flanks = [0.2, -1.3, 1.4, 0.1, 0.9, -0.4], (0.0,) * 6
    near = [angle + 0.4e-4 for angle in joints]
    assert coarse.moving(near, flanks) == pytest.approx(exact.moving(joints, flanks), abs=1e-9)
    assert coarse.moving(near, flanks) != pytest.approx(exact.moving(near, flanks), abs=1e-3)


def test_only_time_in_motion_counts_as_warming(bench_with: Make) -> None:
    bench = bench_with()
    bench.enter_movecorr()
    for _ in range(100):
        bench.answer()
    assert bench.controller.arm.drives.moved_s == 0.0
    bench.ramp(on_a1(2.0), steps=100)
    assert bench.controller.arm.drives.moved_s == pytest.approx(0.4, abs=0.02)
