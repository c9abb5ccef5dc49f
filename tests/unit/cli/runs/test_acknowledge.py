"""`acknowledge`: whose faults are acknowledged, by whom, and what is printed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from plain_steps import plain_order
from recording_cell import RecordingCell, mini_theatre_file
from run_again import broken_off
from user_commands import in_this_process, one_error

from procedures.cli.procedure import app
from procedures.journal.journal import JOURNAL_FILE, ONLY_LEAVING, Entry, Journal, read_journal
from procedures.runs.engine_setup import EngineInput
from procedures.runs.interrupted_run import Resumption, read_interrupted_run
from procedures.runs.lifecycle import open_engine
from procedures.runs.observers import RunObservers
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.request_file import write_request
from procedures.runs.theatre_lock import hold_theatre
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.lifecycle import LONGEST_NAME, Identity, Lifecycle
from ronna_hw.errors import EXIT_LINK_LOST, EXIT_REFUSED, EXIT_USAGE, LinkTimeout
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.theatre import Theatre


@pytest.mark.parametrize("which", [(), ("RUN", "--config", "theatre.toml")])
def test_acknowledge_requires_either_a_run_or_a_theatre(which: tuple[str, ...]) -> None:
    refused = in_this_process(app, "acknowledge", *which)
    assert refused.returncode == EXIT_USAGE
    one_error(refused.stderr)


@pytest.mark.parametrize("by", [(), ("--by", "007"), ("--by", "A" * (LONGEST_NAME + 1))])
def test_acknowledge_without_a_persons_name_is_refused(run: Path, by: tuple[str, ...]) -> None:
    refused = in_this_process(app, "acknowledge", run, *by)
    assert refused.returncode == EXIT_REFUSED
    assert one_error(refused.stderr)[0].startswith("DEV-006")


def test_acknowledge_on_a_finished_run_writes_nothing(run: Path) -> None:
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    done = in_this_process(app, "acknowledge", run, "--by", "A. Nurse")
    assert done.returncode == 0
    assert done.stdout.startswith("the run is finished")
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


@pytest.mark.hazard(2)
def test_a_run_whose_every_step_is_done_is_left_by_an_acknowledgement_not_finished(tmp_path: Path) -> None:
    theatre = mini_theatre_file(tmp_path, simulated=True)
    cell = RecordingCell(tmp_path / "run")
    engine = cell.engine(plain_order())
    engine.run_to()
    assert engine.over
    broken_off(cell)
    acknowledging = Resumption(
        read_interrupted_run(cell.folder), accepted=False, only_leaving=True, asks=False
    )
    opened = open_engine(
        RunRequest(procedure=CaseProcedure(), config=theatre),
        cell.folder,
        lambda _theatre: EngineInput(engine.order),
        RunObservers(),
        resumption=acknowledging,
    )
    with opened:
        pass
    *_, restart, last = read_journal(cell.folder / JOURNAL_FILE)
    assert (restart["entry"], restart.get(ONLY_LEAVING)) == (Entry.RESTARTED, True)
    assert (last["entry"], last["outcome"]) == (Entry.CLOSED, "left")


@pytest.mark.hazard(2)
def test_a_finished_run_whose_arm_is_still_out_is_not_parked(tmp_path: Path) -> None:
    cell = RecordingCell(tmp_path / "run")
    cell.journal.write(Entry.MOTION, 0.0, what="go")
    cell.journal.write(Entry.CLOSED, 0.0, outcome="done")
    left = read_interrupted_run(cell.folder)
    assert left.finished
    assert not left.parked
    assert left.why_home_needs_no_device is None


def test_acknowledge_prints_what_was_acknowledged_and_by_whom(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)  # the theatre in use is marked next to its file
    cell = RecordingCell(tmp_path / "run")
    for device in (cell.tracker, cell.stereo):
        monkeypatch.setattr(device, "recover", lambda _by: None, raising=False)
    monkeypatch.setattr(Theatre, "from_file", lambda _file: cell.opened)
    done = in_this_process(app, "acknowledge", "--config", "theatre.toml", "--by", "A. Nurse")
    assert "acknowledged by A. Nurse: robot.master: " in done.stdout


@pytest.mark.hazard(32)
@pytest.mark.parametrize("by_config", [True, False])
def test_a_fault_of_an_unfinished_run_is_acknowledged_in_that_run(tmp_path: Path, by_config: bool) -> None:
    theatre = mini_theatre_file(tmp_path, simulated=True)
    unfinished, other = (left_on(theatre, tmp_path / name) for name in ("unfinished", "other"))
    with hold_theatre(theatre, unfinished):
        journal = Journal.reopen_run(unfinished, read_chain(unfinished / JOURNAL_FILE))
        journal.write(Entry.MOTION, 0.0, what="go")
        journal.close()
    what = ("--config", theatre) if by_config else (other,)
    refused = in_this_process(app, "acknowledge", *what, "--by", "A. Nurse")
    assert refused.returncode == EXIT_REFUSED
    assert "PRO-044" in refused.stderr
    assert f"ronna-procedure acknowledge {unfinished} --by" in refused.stderr


def left_on(theatre: Path, run: Path) -> Path:
    """A run on that theatre that has just been opened."""
    run.mkdir()
    write_request(RunRequest(procedure=CaseProcedure(), config=theatre), run)
    Journal(run).close()
    return run


def test_acknowledge_recovers_a_theatre_without_a_run_and_lists_unreachable_devices(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)  # the theatre in use is marked next to its file
    cell = RecordingCell(tmp_path / "run")

    def without_power(timeout_s: float = 10.0) -> Identity:
        raise LinkTimeout("the tracker is silent")

    def fails(timeout_s: float = 10.0) -> None:
        cell.stereo.state = Lifecycle.FAULT
        raise LinkTimeout("a camera is lost")

    def recover_from_fault(_by: str) -> None:
        if cell.stereo.state is not Lifecycle.FAULT:
            raise WrongState("recover is not allowed now")
        cell.stereo.state = Lifecycle.CONFIGURED

    monkeypatch.setattr(cell.tracker, "connect", without_power)
    monkeypatch.setattr(cell.stereo, "configure", fails)
    monkeypatch.setattr(cell.stereo, "recover", recover_from_fault, raising=False)
    monkeypatch.setattr(Theatre, "from_file", lambda _file: cell.opened)
    done = in_this_process(app, "acknowledge", "--config", "theatre.toml", "--by", "A. Nurse", "--json")
    assert done.returncode == EXIT_LINK_LOST
    said = json.loads(done.stdout)
    assert sorted(said["acknowledged"]) == ["robot.master", "stereo"]
    assert list(said["unreached"]) == ["tracker"]
    assert cell.arm.calls == ["recovered by A. Nurse"]  # a message; nothing else of it is asked
    assert cell.arm.motions == []
