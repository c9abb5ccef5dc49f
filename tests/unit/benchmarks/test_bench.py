"""The arithmetic of the benchmarks, and one of them from the command line."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from smallest_benchmark import run_python

from benchmarks import figures, history, run
from benchmarks.robot import robot_link
from ronna_hw.arm_stream.records import Choice, RecordedCycle

ROOT = Path(__file__).resolve().parents[3]
RUN = ROOT / "benchmarks" / "run.py"
REST_RAD = (0.0,) * 6
BUSY = """
import sys
for _ in range(2):
    sum(range(6_000_000))
    print(flush=True)
    sys.stdin.read(1)
"""


def test_contestants_take_turns_and_warm_up_rounds_do_not_count() -> None:
    order: list[str] = []

    def contestant(name: str) -> float:
        order.append(name)
        return float(len(order))

    names = ("a", "b", "c")
    samples = figures.run_contest({n: (lambda n=n: contestant(n)) for n in names}, 2, warm_up=1)
    assert "".join(order) == "abcbcacab"
    assert samples == {"a": [6.0, 8.0], "b": [4.0, 9.0], "c": [5.0, 7.0]}


def test_a_ratio_is_computed_per_round_so_that_a_stall_of_the_machine_cancels() -> None:
    samples = {"ours": [2.0, 20.0, 2.2], "bare": [1.0, 10.0, 1.0]}
    ours, bare = figures.compare_samples("time", "s", samples, "bare")
    assert (ours.value, ours.ratio, ours.baseline) == (2.2, 2.0, "bare")
    assert (bare.value, bare.ratio) == (1.0, None)


def test_a_goal_applies_to_the_value_or_the_ratio_and_a_miss_is_reported() -> None:
    ours, bare = figures.compare_samples("rate", "1/s", {"ours": [40.0], "bare": [100.0]}, "bare")
    assert (bare.goal, bare.met) == ("", None)
    assert bare.at_least(100.0).met
    assert ours.ratio_at_least(0.4).met
    missed = ours.at_least(1500.0)
    assert (missed.goal, missed.met) == ("value ≥ 1,500", False)
    assert not ours.ratio_at_least(0.5).met
    assert ours.ratio_at_most(0.4).met
    assert not ours.ratio_at_most(0.3).met
    for set_goal in (bare.ratio_at_least, bare.ratio_at_most):
        with pytest.raises(ValueError, match="baseline"):
            set_goal(1.0)


def test_a_baseline_too_short_for_the_clock_gives_no_ratio() -> None:
    ours, _ = figures.compare_samples("CPU", "s", {"ours": [0.01], "bare": [0.0]}, "bare")
    assert (ours.value, ours.ratio, ours.baseline) == (0.01, None, "")


def test_the_lock_step_rate_counts_only_cycles_in_which_the_arm_moves() -> None:
    def cycle(number: int, received_us: int, A1_rad: float) -> RecordedCycle:
        return RecordedCycle(
            number, 4 * number, received_us * 1000, 10.0, REST_RAD, (A1_rad, *REST_RAD[1:]), Choice.GO
        )

    waiting = [cycle(1, 0, 0.0), cycle(2, 4000, 0.0), cycle(3, 8000, 0.0)]
    moving = [cycle(4, 8100, 0.1), cycle(5, 8200, 0.2), cycle(6, 8300, 0.3)]
    afterwards = [cycle(7, 8400, 0.3), cycle(9, 19_000, 0.4)]
    rate_hz = robot_link.rate_in_motion([*waiting, *moving, *afterwards])
    assert rate_hz == pytest.approx(10_000.0)
    assert robot_link.rate_in_motion(waiting) == 0.0


def test_the_processor_time_of_a_process_grows_with_its_work() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", BUSY], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as busy:
        assert busy.stdin is not None
        assert busy.stdout is not None
        busy.stdout.readline()
        first = figures.process_cpu_s(busy.pid)
        busy.stdin.write(b"\n")
        busy.stdin.flush()
        busy.stdout.readline()
        second = figures.family_cpu_s(busy.pid)
        busy.stdin.close()
    assert 0.0 < first < second


def test_the_peak_memory_of_a_program_is_not_that_of_the_process_that_measures_it() -> None:
    held = bytearray(300_000_000)
    cpu_s, peak_gb = figures.measure_program([sys.executable, "-c", "bytearray(100_000_000)"])
    assert 0.1 < peak_gb < 0.2 < len(held) / 1e9
    assert cpu_s > 0.0


def test_a_measured_program_that_fails_says_why() -> None:
    with pytest.raises(RuntimeError, match="no series"):
        figures.measure_program([sys.executable, "-c", "import sys; sys.exit('no series')"])


def test_every_listed_measurement_exists() -> None:
    for module in run.MEASUREMENTS.values():
        assert (ROOT / "benchmarks" / f"{module.replace('.', '/')}.py").exists()


@pytest.mark.slow
def test_one_measurement_prints_a_table_and_writes_its_figures(tmp_path: Path) -> None:
    done = run_python("-P", RUN, "--only", "set-points", "--out", tmp_path)
    assert "joint move" in done.stdout
    (file,) = tmp_path.glob("*.json")
    content = json.loads(file.read_text())
    assert len((tmp_path / "history.jsonl").read_text().splitlines()) == 1
    figures = {figure["who"]: figure for figure in content["figures"]["set-points"]}
    assert figures["joint move"]["ratio"] > 0.0
    assert content["failures"] == {}


def test_an_unknown_measurement_is_refused_and_the_known_ones_are_listed(tmp_path: Path) -> None:
    done = run_python("-P", RUN, "--only", "tea", "--out", tmp_path, exit_code=2)
    assert "robot-link" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("only", "line", "said"),
    [("nonsense", "", "unknown measurement nonsense"), ("ct", '{"torn": ', "line 1 is not a result")],
)
def test_the_history_refuses_an_unknown_measurement_and_a_torn_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], only: str, line: str, said: str
) -> None:
    file = tmp_path / "history.jsonl"
    file.write_text(line + "\n" if line else "", encoding="utf-8")
    with pytest.raises(typer.BadParameter, match=said):
        history.show(only=[only], file=file)
