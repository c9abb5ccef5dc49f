"""SIGKILL at every line of the journal of a mini case, and power cuts that tear what was being written."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from kills import LARGEST_CHANGE_MM, killed_at, taken_up
from user_commands import Commands

from procedures.engine.journal import JOURNAL_FILE
from ronna_hw.evidence.journal_reading import read_chain

pytestmark = [pytest.mark.soak, pytest.mark.timeout(300)]


@pytest.fixture
def commands() -> Iterator[Commands]:
    started = Commands()
    yield started
    assert started.await_no_survivors() == []


CASE = ("run", "--sim", "--scene", "mini", "--seed", "3", "--json")
UNINTERRUPTED_MM = 0.18021067547021166
LINES = 90  # of this case
TORN_BYTES = (1, 40)  # of the last line, which was not on disk yet


@pytest.mark.hazard(2)
@pytest.mark.parametrize("line", range(LINES))
def test_killed_at_any_line_the_case_reaches_its_target(
    commands: Commands, tmp_path: Path, line: int
) -> None:
    outcome = taken_up(commands, killed_at(commands, CASE, tmp_path, line))
    assert abs(outcome["mean_application_error_mm"] - UNINTERRUPTED_MM) <= LARGEST_CHANGE_MM


@pytest.mark.hazard(2)
@pytest.mark.parametrize("zeroed", [False, True], ids=["torn", "zeroed"])
@pytest.mark.parametrize("lost", TORN_BYTES)
@pytest.mark.parametrize("line", [12, 31, 64, 73, 79, 83])
def test_a_power_cut_tears_the_line_that_was_being_written(
    commands: Commands, tmp_path: Path, line: int, lost: int, zeroed: bool
) -> None:
    killed = killed_at(commands, CASE, tmp_path, line)
    path = killed.folder / JOURNAL_FILE
    content = path.read_bytes()
    path.write_bytes(content[:-lost] + b"\0" * lost * zeroed)
    for name in ("log.jsonl", "events.jsonl"):  # what else was being written
        beside = killed.folder / name
        if beside.exists():
            beside.write_bytes(beside.read_bytes()[:-lost] + b"\0" * lost * zeroed)
    remaining = read_chain(path).lines
    outcome = taken_up(commands, type(killed)(killed.folder, remaining, killed.records))
    assert abs(outcome["mean_application_error_mm"] - UNINTERRUPTED_MM) <= LARGEST_CHANGE_MM
