"""`ronna-procedure recover-log`: copies of logs beside them, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from user_commands import in_this_process, one_error

from procedures.cli.procedure import app
from procedures.journal.journal import JOURNAL_FILE
from procedures.live.flight_log import FlightLog, next_log_file
from procedures.live.log_entries import Level, SaidLine
from procedures.live.records import Began
from ronna_hw.errors import EXIT_FAILED, EXIT_USAGE

BEGAN = Began(theatre_time_s=0.0, run="R1", epoch_ns=0)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run that two programs had; the first was killed."""
    (tmp_path / JOURNAL_FILE).touch()
    for _ in range(2):
        log = FlightLog(next_log_file(tmp_path), BEGAN, str)
        log.take([SaidLine(1.0, Level.INFO, "begun"), SaidLine(3.5, Level.INFO, "done")])
        log.close()
    first = tmp_path / "flight.mcap"
    first.write_bytes(first.read_bytes()[:-100])
    return tmp_path


def test_every_log_of_a_run_is_copied_and_none_is_changed(run: Path) -> None:
    before = {path.name: path.read_bytes() for path in run.glob("*.mcap")}
    done = in_this_process(app, "recover-log", run, "--json")
    assert done.returncode == 0, done.stderr
    logs = json.loads(done.stdout)["logs"]
    assert [one["path"] for one in logs] == [str(run / "export" / name) for name in sorted(before, key=len)]
    assert [(one["messages"], one["duration_s"], one["was_whole"]) for one in logs] == [
        (2, 2.5, False),
        (2, 2.5, True),
    ]
    assert {path.name: path.read_bytes() for path in run.glob("*.mcap")} == before


def test_one_file_is_copied_to_where_it_is_wanted_and_nothing_is_overwritten(
    run: Path, tmp_path: Path
) -> None:
    elsewhere = tmp_path.parent / f"{tmp_path.name}.mcap"
    done = in_this_process(app, "recover-log", run / "flight-2.mcap", "--out", elsewhere)
    assert "2 messages over 2.5 s of theatre time; it was whole" in done.stderr
    again = in_this_process(app, "recover-log", run / "flight-2.mcap", "--out", elsewhere)
    assert again.returncode == EXIT_USAGE
    assert "exists and was not changed" in one_error(again.stderr)[0]


def test_one_name_for_two_logs_and_a_file_of_another_kind_are_refused(run: Path, tmp_path: Path) -> None:
    two = in_this_process(app, "recover-log", run, "--out", tmp_path.parent / "one.mcap")
    assert two.returncode == EXIT_USAGE
    assert "has 2 logs" in one_error(two.stderr)[0]
    foreign = in_this_process(app, "recover-log", run / JOURNAL_FILE)
    assert foreign.returncode == EXIT_FAILED
    assert "LIV-003" in one_error(foreign.stderr)[0]
