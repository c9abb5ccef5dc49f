"""Every run leaves a report, and the exception that ended the run reaches the caller."""

from __future__ import annotations

from pathlib import Path

import pytest
from plain_steps import plain_order
from recording_cell import RecordingCell, mini_theatre_file
from user_commands import in_this_process

from procedures.cli.procedure import app
from procedures.journal.errors import GateFailed
from procedures.journal.journal import JOURNAL_FILE, Entry, Journal
from procedures.reporting import report
from procedures.runs.engine_setup import EngineInput
from procedures.runs.finishing import finalize_run, seal_run, write_final_report
from procedures.runs.interrupted_run import Resumption, read_interrupted_run
from procedures.runs.lifecycle import open_engine
from procedures.runs.observers import RunObservers
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.request_file import write_request
from ronna_hw.clock import ClockUnavailable
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.manifest import REQUEST_FILE


@pytest.mark.hazard(41)
@pytest.mark.parametrize("problem", [GateFailed("too far off"), KeyboardInterrupt()])
def test_a_run_that_ends_in_an_error_or_interrupt_leaves_a_report_and_reraises_it(
    tmp_path: Path, problem: BaseException
) -> None:
    (tmp_path / JOURNAL_FILE).touch()
    with pytest.raises(type(problem)) as met, finalize_run(tmp_path):
        raise problem
    assert met.value is problem
    text = (tmp_path / "report.html").read_text()
    assert ("PRO-007" in text) == isinstance(problem, GateFailed)


@pytest.mark.hazard(41)
def test_while_a_run_is_open_its_page_says_so_and_not_how_it_ended_before(tmp_path: Path) -> None:
    theatre = mini_theatre_file(tmp_path, simulated=True)
    cell = RecordingCell(tmp_path / "run")
    cell.journal.write(Entry.OPENED, 0.0, run="run")
    cell.engine(plain_order()).close("left")
    page = write_final_report(cell.folder)
    seal_run(cell.folder)
    assert page is not None
    assert "The operator left" in page.read_text()
    left = read_interrupted_run(cell.folder)
    opened = open_engine(
        RunRequest(procedure=CaseProcedure(), config=theatre),
        cell.folder,
        lambda _theatre: EngineInput(plain_order()),
        RunObservers(),
        resumption=Resumption(left, accepted=False, only_leaving=True, asks=False),
    )
    with opened:
        text = page.read_text()
        assert not inspect_run(cell.folder).changes
    assert "The operator left" not in text
    assert "run: not finished" in text
    assert f"ronna-procedure report {cell.folder}" in text


@pytest.mark.parametrize(("moved", "said"), [(True, "the arm is where it stopped"), (False, "has moved")])
def test_an_interrupt_prints_where_the_arm_is_and_how_to_resume(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], moved: bool, said: str
) -> None:
    (tmp_path / REQUEST_FILE).touch()
    journal = Journal(tmp_path)
    journal.write(Entry.OPENED, 0.0)
    if moved:
        journal.write(Entry.MOTION, 1.0)
    journal.close()
    with pytest.raises(KeyboardInterrupt), finalize_run(tmp_path):
        raise KeyboardInterrupt
    shown = capsys.readouterr().err
    assert said in shown
    assert ("ronna-procedure home" in shown) == moved
    assert f"ronna-procedure resume {tmp_path}" in shown


def test_a_run_whose_theatre_has_ended_says_to_start_the_theatre_again_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_request(
        RunRequest(procedure=CaseProcedure(), config=tmp_path / "theatre" / "theatre.toml"), tmp_path
    )
    journal = Journal(tmp_path)
    journal.write(Entry.OPENED, 0.0)
    journal.write(Entry.MOTION, 1.0)
    journal.close()
    with pytest.raises(ClockUnavailable), finalize_run(tmp_path):
        raise ClockUnavailable("cannot open the clock")
    first, _, then = capsys.readouterr().err.partition(
        f"theatre --out {tmp_path / 'theatre'} --continue, then"
    )
    assert first.endswith("its theatre has ended: start it again with ronna-sim ")
    assert then.startswith(f" ronna-procedure home {tmp_path} or ronna-procedure resume {tmp_path}")


@pytest.mark.hazard(41)
def test_a_failure_to_write_the_report_does_not_mask_the_original_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object, **__: object) -> Path:
        raise OSError(28, "No space left on device", "report.html")

    (tmp_path / JOURNAL_FILE).touch()
    monkeypatch.setattr(report, "write_report", full)
    with pytest.raises(GateFailed), finalize_run(tmp_path):
        raise GateFailed("too far off")
    shown = capsys.readouterr().err
    assert "the report could not be written: CLI-003: report.html: " in shown
    assert f"To write it: ronna-procedure report {tmp_path}" in shown


def test_the_report_of_a_run_killed_at_its_start_is_printed_by_its_path_without_control_characters(
    tmp_path: Path,
) -> None:
    run = tmp_path / "r\x1b[2Jx"
    run.mkdir()
    (run / "log.jsonl").touch()
    done = in_this_process(app, "report", run)
    assert (done.returncode, done.stdout) == (0, f"{tmp_path}/r\\x1b[2Jx/report.html\n")
