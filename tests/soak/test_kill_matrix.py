"""Kills at every journal line of a mini case and at ten of a full one, and power cuts at some of them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from kills import LARGEST_CHANGE_MM, reopen_run
from run_folders import run_folder
from shared_by_workers import made_once
from snapshots import snapshot_at, take_snapshots
from user_commands import Commands, in_this_process

from procedures.cli.procedure import app as ronna_procedure
from procedures.journal.journal import JOURNAL_FILE
from ronna_hw.evidence.journal_reading import read_chain
from sim.cli import app as ronna_sim

pytestmark = [pytest.mark.soak, pytest.mark.timeout(600)]

MINI = ("run", "--sim", "--scene", "mini", "--seed", "3", "--json")
MINI_LINES = 179
FULL_LINES = (5, 58, 101, 122, 144, 186, 250, 320, 380, 430)  # of 465
FULL = ("run", "--sim", "--seed", "7", "--json")
# Kind of a line, and a word that the first such line has.
POWER_CUTS = (
    ("intent", "plan_check"),
    ("confirmation", "head_clamped"),
    ("work", "cart_push"),
    ("result", "global_localization"),
    ("intent", "relocalization:T1"),
    ("motion", "go"),
    ("motion", "settle"),
    ("result", "relocalization:T1"),
    ("confirmation", "registration:T1"),
    ("confirmation", "tool_change"),
    ("work", "gauge"),
    ("confirmation", "instrument_out"),
    ("motion", "insert"),
    ("instrument", "T1"),
    ("confirmation", "drill:T1"),
    ("work", "insert"),
    ("motion", "withdraw"),
    ("intent", "confirmation:T1"),
)


Case = tuple[Path, list[float]]  # snapshots of a case, and its target errors without a kill


def snapshots_of(factory: pytest.TempPathFactory, name: str, take: Callable[[Path], int]) -> tuple[Case, int]:
    folder, lines = made_once(factory, name, lambda folder: str(take(folder)))
    finished = run_folder(folder / "runs")
    assert finished is not None
    verified = in_this_process(ronna_sim, "verify", finished, "--json")
    errors_mm = [row["application_error_mm"] for row in json.loads(verified.stdout)["targets"]]
    return (folder, errors_mm), int(lines)


@pytest.fixture(scope="module")
def mini(tmp_path_factory: pytest.TempPathFactory) -> Case:
    case, lines = snapshots_of(tmp_path_factory, "mini", lambda to: take_snapshots(Commands(), MINI, to))
    assert lines == MINI_LINES, f"a case has {lines} lines now: MINI_LINES is of a former one"
    return case


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Case:
    case, lines = snapshots_of(
        tmp_path_factory, "full", lambda to: take_snapshots(Commands(), FULL, to, FULL_LINES.__contains__)
    )
    assert lines > max(FULL_LINES)
    return case


def line_of(folder: Path, entry: str, word: str) -> int:
    """The number of the first line of that kind with that word."""
    finished = run_folder(folder / "runs")
    assert finished is not None
    lines = enumerate(read_chain(finished / JOURNAL_FILE).lines)
    return next(number for number, line in lines if line["entry"] == entry and word in line.values())


def assert_same_targets(outcome: dict[str, Any], uninterrupted_mm: list[float]) -> None:
    errors_mm = [one["application_error_mm"] for one in outcome["targets"]]
    assert errors_mm == pytest.approx(uninterrupted_mm, abs=LARGEST_CHANGE_MM)


@pytest.mark.hazard(2)
@pytest.mark.parametrize("line", range(MINI_LINES))
def test_a_case_killed_at_any_journal_line_reaches_its_target(
    commands: Commands, mini: Case, tmp_path: Path, line: int
) -> None:
    folder, uninterrupted_mm = mini
    snapshot = snapshot_at(folder, line, tmp_path)
    assert_same_targets(reopen_run(commands, snapshot.killed()), uninterrupted_mm)
    replayed = in_this_process(ronna_procedure, "replay", snapshot.folder, "--json")
    assert replayed.returncode == 0, replayed.stdout


@pytest.mark.hazard(2)
@pytest.mark.parametrize("zeroed", [False, True], ids=["torn", "zeroed"])
@pytest.mark.parametrize("moment", POWER_CUTS, ids=" ".join)
def test_a_case_reaches_its_target_after_a_power_cut_tore_its_open_files(
    commands: Commands, mini: Case, tmp_path: Path, moment: tuple[str, str], zeroed: bool
) -> None:
    folder, uninterrupted_mm = mini
    snapshot = snapshot_at(folder, line_of(folder, *moment), tmp_path)
    snapshot.cut_power(zeroed=zeroed)
    assert_same_targets(reopen_run(commands, snapshot.killed()), uninterrupted_mm)


@pytest.mark.hazard(2)
@pytest.mark.parametrize("line", FULL_LINES)
def test_a_full_case_killed_at_any_of_ten_journal_lines_reaches_its_targets(
    commands: Commands, full: Case, tmp_path: Path, line: int
) -> None:
    folder, uninterrupted_mm = full
    assert_same_targets(reopen_run(commands, snapshot_at(folder, line, tmp_path).killed()), uninterrupted_mm)
