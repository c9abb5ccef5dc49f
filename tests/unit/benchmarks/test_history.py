"""Results by date, their changes, and what is marked as a loss."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest
from smallest_benchmark import run_python

from benchmarks.figures import Figure
from benchmarks.history import Key, append_result, read_history

RATE = Figure("readings/s", "driver", 900.0, "1/s")


def _append(folder: Path, day: int, *figures: Figure, processor: str = "one") -> Path:
    content = {
        "date": f"2026-11-{day:02}T12:00:00+00:00",
        "commit": f"c0ffee{day}",
        "machine": {"processor": processor, "cpus": 2},
        "figures": {"tracker": [asdict(figure) for figure in figures]},
    }
    path = folder / "history.jsonl"
    append_result(content, path)
    return path


def _latest_change(path: Path, figure: Figure) -> tuple[float | None, bool]:
    *_, earlier, latest = read_history(path)[Key("tracker", figure.what, figure.who, figure.baseline)]
    change = latest.change_since(earlier)
    return change, latest.is_loss(change)


@pytest.mark.parametrize(
    ("unit", "before", "after", "is_loss"),
    [
        ("1/s", 1000.0, 900.0, True),
        ("1/s", 1000.0, 910.0, False),
        ("1/s", 1000.0, 1200.0, False),
        ("µs", 10.0, 11.0, True),
        ("µs", 10.0, 10.9, False),
        ("", 10.0, 20.0, False),
    ],
)
def test_a_lower_rate_or_a_longer_time_by_a_tenth_is_a_loss(
    tmp_path: Path, unit: str, before: float, after: float, is_loss: bool
) -> None:
    figure = Figure("what", "who", after, unit)
    _append(tmp_path, 1, Figure("what", "who", before, unit))
    path = _append(tmp_path, 2, figure)
    change, found = _latest_change(path, figure)
    assert change == pytest.approx(after / before - 1.0, abs=1e-3)
    assert found is is_loss


def test_a_goal_says_which_direction_is_a_loss(tmp_path: Path) -> None:
    figure = Figure("points given", "who", 80.0, "%").at_least(95.0)
    _append(tmp_path, 1, Figure("points given", "who", 99.0, "%").at_least(95.0))
    assert _latest_change(_append(tmp_path, 2, figure), figure)[1]


def test_between_machines_only_ratios_are_compared(tmp_path: Path) -> None:
    bare = Figure("readings/s", "bare", 2000.0, "1/s")
    ours = Figure("readings/s", "driver", 1000.0, "1/s", 0.5, "bare")
    _append(tmp_path, 1, ours, bare)
    slower = Figure("readings/s", "driver", 400.0, "1/s", 0.4, "bare")
    path = _append(tmp_path, 2, slower, Figure("readings/s", "bare", 1000.0, "1/s"), processor="other")
    change, is_loss = _latest_change(path, slower)
    assert change == pytest.approx(-0.2)
    assert is_loss
    assert _latest_change(path, bare) == (None, False)


def test_the_results_are_printed_by_date_and_losses_at_the_end(tmp_path: Path) -> None:
    _append(tmp_path, 9, RATE)
    path = _append(tmp_path, 2, Figure("readings/s", "driver", 1000.0, "1/s"))
    done = run_python("-m", "benchmarks.history", "--file", path, "--only", "tracker")
    title, earlier, later, _, summary, lost = done.stdout.strip().splitlines()
    assert title == "tracker: readings/s, driver"
    assert earlier.split() == ["2026-11-02", "c0ffee2", "1,000", "1/s"]
    assert later.split() == ["2026-11-09", "c0ffee9", "900", "1/s", "-10%", "LOSS"]
    assert summary == "lost 10% or more since the result before: 1"
    assert lost.strip() == "readings/s, driver: -10%"


def test_without_results_the_history_says_what_adds_one(tmp_path: Path) -> None:
    done = run_python("-m", "benchmarks.history", "--file", tmp_path / "none.jsonl")
    assert "make bench" in done.stdout
