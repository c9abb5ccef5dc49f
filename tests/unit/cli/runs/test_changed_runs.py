"""A run is left sealed, and every command names what has changed in it since."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from plain_steps import plain_order
from recording_cell import RecordingCell
from user_commands import in_this_process

from procedures.cli.procedure import app
from procedures.engine.events import CaseState
from procedures.engine.events.event_file import EventFile
from procedures.engine.events.stream import EventStream
from procedures.journal.journal import JOURNAL_FILE
from procedures.reporting import report as written_report
from procedures.reporting.kept_truth import load_truth, store_truth
from procedures.reporting.outcome import TargetTruth, Truth
from procedures.runs import finishing
from procedures.runs.case import clinical_input
from procedures.runs.finishing import rebuild_report, seal_run
from procedures.runs.interrupted_run import read_interrupted_run
from procedures.runs.reopening import close_completed_run, prepare_folder
from procedures.runs.request import CaseProcedure
from procedures.runs.request_file import REQUEST_FILE
from ronna_hw.devices.capabilities import Direction
from ronna_hw.errors import EXIT_REFUSED
from ronna_hw.evidence import manifest
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE
from ronna_hw.evidence.manifest import RECORDS_FOLDER, SEAL_FILE
from ronna_hw.recording.flight_recorder import BYTES_FOLDER, FlightRecorder
from studies.cli import app as campaign


def test_verify_reports_that_a_run_is_intact_or_names_the_changed_files(run: Path) -> None:
    whole = in_this_process(app, "verify", run, "--json")
    assert (whole.returncode, json.loads(whole.stdout)["whole"]) == (0, True)
    (run / "records" / "01-image.json").write_text("{}")
    (run / "note.txt").write_text("added")
    changed = in_this_process(app, "verify", run, "--json")
    assert changed.returncode == EXIT_REFUSED
    files = {problem["file"] for problem in json.loads(changed.stdout)["problems"]}
    assert files == {"records/01-image.json", "note.txt"}


def test_verify_names_the_folders_of_a_run_that_it_does_not_look_into(run: Path) -> None:
    (run / ".raw.partial").mkdir()
    done = in_this_process(app, "verify", run)
    assert done.returncode == 0
    assert done.stdout.splitlines()[-1] == "not part of the run, and not checked: .raw.partial"


def lines_of(run: Path) -> list[bytes]:
    return (run / JOURNAL_FILE).read_bytes().splitlines(keepends=True)


# File and new content, None to remove it.
SPOILT: dict[str, tuple[str, Callable[[Path], bytes | None]]] = {
    "another's record": (
        "records/01-image.json",
        lambda run: (run / "records/02-localization-T1.json").read_bytes(),
    ),
    "line removed": (JOURNAL_FILE, lambda run: b"".join([*lines_of(run)[:5], *lines_of(run)[6:]])),
    "last line removed": (JOURNAL_FILE, lambda run: b"".join(lines_of(run)[:-1])),
    "record gone": ("records/01-image.json", lambda _run: None),
    "request changed": (REQUEST_FILE, lambda run: (run / REQUEST_FILE).read_bytes() + b" "),
    "file added": ("note.txt", lambda _run: b"added"),
}


def spoil(run: Path, how: str) -> str:
    name, change = SPOILT[how]
    content = change(run)
    if content is None:
        (run / name).unlink()
    else:
        (run / name).write_bytes(content)
    return name


@pytest.mark.hazard(39)
@pytest.mark.parametrize("how", SPOILT)
def test_every_command_names_the_changed_file_of_a_run(run: Path, how: str) -> None:
    name = spoil(run, how)
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    relied_on = name.startswith((RECORDS_FOLDER, JOURNAL_FILE))  # by a replay, and by the times
    commands = [(app, command) for command in ("export", "resume", "lineage", "report")]
    for program, command in (*commands, *[(app, "replay"), (campaign, "times")] * relied_on):
        refused = in_this_process(program, command, run)
        assert (command, refused.returncode) == (command, EXIT_REFUSED)
        assert f"PRO-033: {run.name} is not as it was left: {name}: " in refused.stderr
        assert refused.stdout == ""
    assert f"NOT AS THE RUN LEFT IT: {name}" in in_this_process(app, "show", run).stdout
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
    reported = in_this_process(app, "report", run, "--out", run.parent / "report")
    assert name in reported.stderr
    page = (run.parent / "report" / "report.html").read_text()
    assert (
        f"This folder is not as the run left it. Do not rely on anything below.</strong><ul><li>{name}"
        in page
    )


def test_show_does_not_advise_to_resume_a_changed_run(run: Path) -> None:
    (run / SEAL_FILE).unlink()
    (run / JOURNAL_FILE).write_bytes(b"".join(lines_of(run)[:-1]))  # killed
    assert f"next: ronna-procedure resume {run}" in in_this_process(app, "show", run).stdout
    spoil(run, "record gone")
    shown = in_this_process(app, "show", run).stdout
    assert "ronna-procedure resume" not in shown
    assert f"next: ronna-procedure verify {run}" in shown


@pytest.mark.hazard(39)
def test_a_full_disk_while_sealing_a_run_loses_nothing(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / SEAL_FILE).unlink()
    with monkeypatch.context() as full:
        full.setattr(os, "fsync", lambda _file: (_ for _ in ()).throw(OSError(errno.ENOSPC, "disk full")))
        seal_run(run)
    assert "the run could not be sealed" in capsys.readouterr().err
    assert [problem.file for problem in inspect_run(run).problems] == [SEAL_FILE]
    refused = in_this_process(app, "export", run)
    assert refused.returncode == EXIT_REFUSED
    assert "is not finished: seal.json: missing" in refused.stderr
    seal_run(run)
    assert inspect_run(run).problems == ()


@pytest.mark.hazard(39)
@pytest.mark.parametrize("moment", ["write_report", "_take_over", "seal_report"])
def test_an_interrupted_report_does_not_leave_the_run_changed(
    run: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    where = {"write_report": written_report, "seal_report": manifest}.get(moment, finishing)
    original = getattr(where, moment)

    def interrupted(*arguments: Any, **options: Any) -> None:
        original(*arguments, **options)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(where, moment, interrupted)
        with pytest.raises(KeyboardInterrupt):
            rebuild_report(run)
    assert inspect_run(run).changes == ()
    assert rebuild_report(run) == run / "report.html"
    assert inspect_run(run).problems == ()


@pytest.mark.hazard(39)
def test_missing_files_of_the_report_alone_are_made_anew(run: Path) -> None:
    picture = rebuild_report(run).parent / "report" / "timeline.csv"
    (run / "report.html").unlink()
    picture.unlink()
    named = json.loads(in_this_process(app, "verify", run, "--json").stdout)["problems"]
    assert {problem["file"] for problem in named} == {"report.html", "report/timeline.csv"}
    refused = in_this_process(app, "export", run)
    assert (refused.returncode, "report RUN its report" in refused.stderr) == (EXIT_REFUSED, True)
    made = in_this_process(app, "report", run)
    assert (made.returncode, made.stdout) == (0, f"{run / 'report.html'}\n")
    assert "not as the run left it" not in (run / "report.html").read_text()
    assert picture.exists()
    assert inspect_run(run).problems == ()
    (run / "report.html").unlink()
    spoil(run, "another's record")
    assert in_this_process(app, "report", run).returncode == EXIT_REFUSED


def test_a_missing_check_after_the_operation_is_not_forgotten_by_a_new_report(run: Path) -> None:
    kept = run / "report" / "postoperative.json"
    kept.parent.mkdir(exist_ok=True)
    kept.write_text("{}")
    seal_run(run)
    kept.unlink()
    refused = in_this_process(app, "report", run)
    assert refused.returncode == EXIT_REFUSED
    assert "report/postoperative.json: missing" in refused.stderr


def test_an_end_written_later_records_ct_and_plan_outside_the_run(tmp_path: Path) -> None:
    case, folder = tmp_path / "case", tmp_path / "run"
    (case / "ct").mkdir(parents=True)
    for name in ("ct/1.dcm", "plan.toml"):
        (case / name).write_text("as it was")
    cell = RecordingCell(folder)
    cell.engine(plain_order()).run_to()
    cell.journal.close()  # killed before its end
    close_completed_run(read_interrupted_run(folder), clinical_input(CaseProcedure(case=case), folder))
    assert inspect_run(folder).changes == ()
    (case / "plan.toml").write_text("another")
    assert [str(one) for one in inspect_run(folder).changes] == [f"{case / 'plan.toml'}: changed"]


@pytest.mark.parametrize("seal", [True, False], ids=["sealed", "seal removed"])
def test_list_omits_an_error_from_a_changed_file_and_names_the_file(run: Path, seal: bool) -> None:
    store_truth(run, Truth(targets=(TargetTruth(id="T1", application_error_mm=1.25),)))
    seal_run(run)
    (row,) = json.loads(in_this_process(app, "list", run.parent, "--json").stdout)["runs"]
    assert (row["max_application_error_mm"], row["problems"]) == (1.25, [])
    store_truth(run, Truth(targets=(TargetTruth(id="T1", application_error_mm=0.125),)))
    if not seal:
        (run / SEAL_FILE).unlink()
    (row,) = json.loads(in_this_process(app, "list", run.parent, "--json").stdout)["runs"]
    what = "changed" if seal else "not confirmed by a seal"
    assert (row["max_application_error_mm"], row["problems"]) == (None, [f"report/truth.json: {what}"])
    table = in_this_process(app, "list", run.parent).stdout
    assert "0.125" not in table
    assert f"{run.name} is not reliable: report/truth.json: {what}" in table


@pytest.mark.parametrize("restore", [lambda run: prepare_folder(read_interrupted_run(run)), rebuild_report])
def test_no_session_vouches_for_an_error_that_no_seal_confirms(
    run: Path, restore: Callable[[Path], object]
) -> None:
    truth = Truth(targets=(TargetTruth(id="T1", application_error_mm=1.25),))
    kept = store_truth(run, truth)
    seal_run(run)
    prepare_folder(read_interrupted_run(run))
    assert load_truth(run) == truth
    store_truth(run, Truth(targets=(TargetTruth(id="T1", application_error_mm=0.125),)))
    (run / SEAL_FILE).unlink()
    restore(run)
    assert not kept.exists()


def test_bytes_of_a_changed_run_are_printed_after_what_has_changed(run: Path) -> None:
    recorder = FlightRecorder(run / BYTES_FOLDER, lambda: 1.0)
    recorder.on_bytes("tracker", Direction.SENT, b"sent after the end")
    recorder.close()
    printed = in_this_process(app, "bytes", run)
    assert printed.stderr.startswith("NOT AS THE RUN LEFT IT: bytes/tracker.a.jsonl.gz: added")
    assert b"sent after".hex(" ") in printed.stdout


def test_watch_first_names_the_files_changed_since_the_run_finished(run: Path) -> None:
    stream = EventStream()
    file = EventFile(run, stream)
    stream.publish(CaseState(state="finished"))
    stream.end()
    file.join()
    seal_run(run)
    assert "NOT AS THE RUN LEFT IT" not in in_this_process(app, "watch", run).stderr
    events = run / EVENTS_FILE
    events.write_bytes(events.read_bytes().replace(b"finished", b"recovery"))
    said = in_this_process(app, "watch", run).stderr.splitlines()
    assert said[0] == "NOT AS THE RUN LEFT IT: events.jsonl: changed"
