"""Kills at every line of the journal of a mini case, at ten of a full one, and power cuts at some of them."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from kills import LARGEST_CHANGE_MM, taken_up
from shared_by_workers import made_once
from snapshots import snapshot_at, take_snapshots
from user_commands import Commands, in_this_process

from procedures.cli.procedure import app as ronna_procedure

pytestmark = [pytest.mark.soak, pytest.mark.timeout(600)]

MINI = ("run", "--sim", "--scene", "mini", "--seed", "3", "--json")
MINI_ERRORS_MM = [0.18021067547021166]  # of an uninterrupted run
MINI_LINES = 93
FULL = ("run", "--sim", "--seed", "7", "--json")
# A sphere is centred, the tool is exchanged, the instrument goes in, is inside, and comes out, among others.
POWER_CUTS = (5, 12, 17, 31, 45, 58, 64, 73, 76, 79, 83, 87)


@pytest.fixture
def commands() -> Iterator[Commands]:
    started = Commands()
    yield started
    assert started.await_no_survivors() == []


@pytest.fixture(scope="module")
def mini(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def take(folder: Path) -> str:
        return str(take_snapshots(Commands(), MINI, folder))

    folder, lines = made_once(tmp_path_factory, "mini", take)
    assert int(lines) == MINI_LINES
    return folder


@pytest.mark.hazard(2)
@pytest.mark.parametrize("line", range(MINI_LINES))
def test_killed_at_any_line_a_case_reaches_its_target(commands: Commands, mini: Path, line: int) -> None:
    snapshot = snapshot_at(mini, line)
    outcome = taken_up(commands, snapshot.killed())
    errors_mm = [one["application_error_mm"] for one in outcome["targets"]]
    assert errors_mm == pytest.approx(MINI_ERRORS_MM, abs=LARGEST_CHANGE_MM)
    replayed = in_this_process(ronna_procedure, "replay", snapshot.folder, "--json")
    assert replayed.returncode == 0, replayed.stdout
