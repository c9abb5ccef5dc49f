"""A rebuilt report vouches for nothing: journal and seal stay, and it says what no seal confirms."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from coded_errors import raises
from finished_runs import changed_files
from user_commands import in_this_process

from procedures.cli.procedure import app
from procedures.journal.journal import JOURNAL_FILE
from procedures.reporting.kept_truth import load_sealed_truth, store_truth
from procedures.reporting.outcome import Truth
from procedures.runs.finishing import complete_seal, finalize_run
from procedures.runs.interrupted_run import read_interrupted_run
from ronna_hw.errors import EXIT_DONE, EXIT_REFUSED, DeviceError
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.journal_reading import RUN_CHANGED
from ronna_hw.evidence.manifest import LOG_FILES, SEAL_FILE, WORLD_FILE, seal_report

NOT_CERTAIN = "This run is intact only as far as can be said."


@pytest.mark.hazard(39)
def test_a_report_of_a_run_without_a_seal_names_what_nothing_vouches_for(run: Path) -> None:
    (run / SEAL_FILE).unlink()
    (run / WORLD_FILE).unlink()
    journal = (run / JOURNAL_FILE).read_bytes()
    done = in_this_process(app, "report", run)
    assert done.returncode == EXIT_DONE
    page = (run / "report.html").read_text()
    for shown in (done.stderr, page):
        assert "not vouched for: events.jsonl (" in shown
        assert f"{WORLD_FILE} (missing)" in shown
    assert NOT_CERTAIN in page
    assert (run / JOURNAL_FILE).read_bytes() == journal
    assert not (run / SEAL_FILE).exists()
    assert in_this_process(app, "verify", run).returncode == EXIT_REFUSED


@pytest.mark.hazard(39)
def test_a_run_sealed_only_when_it_was_resumed_says_so_in_its_report(run: Path) -> None:
    assert in_this_process(app, "report", run).returncode == EXIT_DONE
    assert NOT_CERTAIN not in (run / "report.html").read_text()
    (run / SEAL_FILE).unlink()
    (run / WORLD_FILE).unlink()
    with complete_seal(read_interrupted_run(run)):
        pass
    page = (run / "report.html").read_text()
    assert NOT_CERTAIN in page
    assert f"{WORLD_FILE} (missing) had no seal when the run was resumed" in page


@pytest.mark.hazard(39)
@pytest.mark.parametrize("name", LOG_FILES)
def test_events_and_log_of_another_run_are_named_and_never_sealed(run: Path, name: str) -> None:
    line = {"entry": "opened", "run": "another"}
    event = {"what": {"kind": "journal", "line": line}}
    (run / SEAL_FILE).unlink()
    (run / name).write_text(json.dumps(event if name == "events.jsonl" else line) + "\n")
    refused = in_this_process(app, "report", run)
    assert refused.returncode == EXIT_REFUSED
    assert f"{name}: belongs to another run: another" in refused.stderr
    with raises(RUN_CHANGED, match=name):
        read_interrupted_run(run)


@pytest.mark.hazard(39)
def test_a_new_report_of_a_sealed_run_leaves_the_rest_of_its_seal(run: Path) -> None:
    assert in_this_process(app, "report", run).returncode == EXIT_DONE
    assert inspect_run(run).problems == ()
    (run / "log.jsonl").write_text("exchanged meanwhile\n")
    seal_report(run)
    assert changed_files(run) == {"log.jsonl"}


def test_the_truth_stays_sealed_while_a_report_is_replaced(run: Path) -> None:
    store_truth(run, Truth())
    seal_report(run)
    seal_report(run, finished=False)  # killed here
    assert load_sealed_truth(run) == Truth()


@pytest.mark.hazard(39)
@pytest.mark.parametrize("sealed", [True, False])
def test_a_command_that_fails_before_its_first_line_vouches_for_nothing(run: Path, sealed: bool) -> None:
    (run / WORLD_FILE).write_text("")
    (run / "notes.txt").write_text("mine")
    if not sealed:
        (run / SEAL_FILE).unlink()
    left = read_interrupted_run(run, only_leaving=True)
    (run / "log.jsonl").write_text("written by this command\n")
    with pytest.raises(DeviceError), finalize_run(run, left):
        raise DeviceError("no device answers")
    named = {problem.file for problem in inspect_run(run).problems}
    assert named == ({WORLD_FILE, "notes.txt"} if sealed else {SEAL_FILE, "notes.txt"})
