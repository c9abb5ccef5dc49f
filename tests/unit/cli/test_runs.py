"""Commands on existing runs, tried on small runs made in this process."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import pytest
from plain_steps import plain_order
from recording_cell import RecordingCell
from user_commands import in_this_process, one_error

from procedures.cli.calibrating.running import new_folder
from procedures.cli.case import display, stepping
from procedures.cli.case.case_inputs import clinical_input
from procedures.cli.case.display import follow_case
from procedures.cli.case.leaving_report import seal_run
from procedures.cli.case.request import CalibrationRun, CaseRequest, new_run_folder
from procedures.cli.case.request_file import REQUEST_FILE, read_request, write_request
from procedures.cli.case.scene_choice import SceneChoice
from procedures.cli.case.stepping import step_through
from procedures.cli.procedure import app
from procedures.cli.runs import report as runs_report
from procedures.cli.runs import resume as runs_resume
from procedures.cli.runs.commands import COMMANDS
from procedures.cli.runs.left_runs import close_left
from procedures.cli.runs.report import make_report
from procedures.engine.errors import BadRequestFile, OtherProgram
from procedures.engine.events import CaseState
from procedures.engine.events.event_file import EVENTS_FILE, EventFile
from procedures.engine.events.stream import EventStream
from procedures.engine.left_run import read_left_run
from procedures.engine.run_lock import held_run
from procedures.journal.journal import JOURNAL_FILE, Entry
from procedures.operator.errors import OperatorAborted
from procedures.reporting import report as written_report
from procedures.reporting.files import keep_truth
from procedures.reporting.outcome import TargetTruth, Truth
from procedures.steps.calibration.recipe import Calibrated, Recipe
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.lifecycle import Identity, Lifecycle
from ronna_hw.errors import (
    EXIT_FAILED,
    EXIT_LINK_LOST,
    EXIT_RECOVERY_NEEDED,
    EXIT_REFUSED,
    EXIT_USAGE,
    LinkTimeout,
)
from ronna_hw.evidence.inspection import RECORDS_FOLDER, inspected
from ronna_hw.evidence.seal import SEAL_FILE
from ronna_hw.theatre import Theatre


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A finished run in the folder `runs`."""
    folder = tmp_path / "runs" / "20260101T000000-abcd"
    folder.parent.mkdir()
    cell = RecordingCell(folder)
    write_request(CaseRequest(out=folder.parent), folder)
    cell.journal.write(Entry.OPENED, 0.0, theatre="a test", banner="", strategy="ocs", seed=None)
    engine = cell.engine(plain_order("T1"))
    engine.run_to(engine.order.find("fit:T1"))
    engine.run_step(engine.order.find("localization:T1"))
    engine.run_to()
    engine.close("done")
    seal_run(folder)
    return folder


def test_the_request_is_the_first_file_and_records_what_was_asked_for(tmp_path: Path) -> None:
    asked = CaseRequest(
        out=tmp_path, choice=SceneChoice("mini", 7, 4), strategy="nos", speed="1", faults=Path("/a/b.txt")
    )
    folder = new_run_folder(asked)
    assert [path.name for path in folder.iterdir()] == [REQUEST_FILE]
    assert read_request(folder) == asked


def test_the_request_of_a_calibration_records_the_recipe_of_its_steps(tmp_path: Path) -> None:
    recipe = Recipe(of=Calibrated.TIP, looks=8, more=3, ball_mm=(500.0, 0.0, 200.0)).model_dump(mode="json")
    asked = CalibrationRun(
        choice=SceneChoice("mini", 7, first_day=True), recipe=recipe, days=30, write=Path("/a/tip.toml")
    )
    folder = new_folder(tmp_path, "tool-tip", asked)
    assert [path.name for path in folder.iterdir()] == [REQUEST_FILE]
    assert read_request(folder) == asked
    refused = in_this_process(app, "resume", folder, "--accept", "--console")
    assert refused.returncode == EXIT_USAGE
    assert "--console operates cases" in one_error(refused.stderr)[0]


@pytest.mark.hazard(2)
def test_resume_refuses_a_run_of_another_version(tmp_path: Path) -> None:
    folder = new_run_folder(CaseRequest(out=tmp_path))
    path = folder / REQUEST_FILE
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"program": "0.0.1"}))
    with pytest.raises(OtherProgram, match="PRO-031"):
        read_request(folder)
    refused = in_this_process(app, "resume", folder, "--accept")
    assert refused.returncode == EXIT_RECOVERY_NEEDED
    one_error(refused.stderr)


@pytest.mark.parametrize("content", [None, "", '{"schema": 1}', "\0\0\0"])
def test_a_folder_that_is_not_a_run_is_refused(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / REQUEST_FILE).write_text(content)
    with pytest.raises(BadRequestFile, match="PRO-034"):
        read_request(tmp_path)


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != "list"])
def test_every_command_on_a_run_refuses_other_folders_with_the_same_error(
    tmp_path: Path, command: str
) -> None:
    for folder in (tmp_path, tmp_path / "none"):
        refused = in_this_process(app, command, folder)
        assert refused.returncode == EXIT_FAILED
        assert f"CLI-005: {folder} is not the folder of a run" in one_error(refused.stderr)[0]


@pytest.mark.hazard(42)
@pytest.mark.parametrize("command", [("resume", "--accept"), ("report",)], ids=lambda command: command[0])
def test_a_run_open_in_another_program_is_refused(tmp_path: Path, command: tuple[str, ...]) -> None:
    folder = new_run_folder(CaseRequest(out=tmp_path))
    with held_run(folder):
        refused = in_this_process(app, *command, folder)
    assert refused.returncode == EXIT_REFUSED
    assert "PRO-030" in refused.stderr


@pytest.mark.hazard(42)
@pytest.mark.parametrize(("lead", "options"), [(follow_case, {"as_json": False}), (step_through, {})])
def test_a_command_that_drives_a_case_locks_its_run_before_opening_anything(
    tmp_path: Path,
    lead: Callable[..., None],
    options: dict[str, bool],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refused: list[int] = []

    def opened(_request: CaseRequest, folder: Path, *_: object) -> NoReturn:
        refused.append(in_this_process(app, "resume", folder, "--accept").returncode)
        raise OperatorAborted("seen enough")

    monkeypatch.setattr(display, "run_case", opened)
    monkeypatch.setattr(stepping, "opened_case", opened)
    with pytest.raises(OperatorAborted):
        lead(CaseRequest(out=tmp_path), **options)
    assert refused == [EXIT_REFUSED]


def test_resume_refuses_the_accept_option_on_real_devices(tmp_path: Path) -> None:
    folder = new_run_folder(CaseRequest(out=tmp_path, config=tmp_path / "theatre.toml", case=tmp_path))
    refused = in_this_process(app, "resume", folder, "--accept")
    assert refused.returncode == EXIT_USAGE


def test_verify_reports_that_a_run_is_intact_or_names_the_changed_files(run: Path) -> None:
    whole = in_this_process(app, "verify", run, "--json")
    assert (whole.returncode, json.loads(whole.stdout)["whole"]) == (0, True)
    (run / "records" / "01-image.json").write_text("{}")
    (run / "note.txt").write_text("added")
    changed = in_this_process(app, "verify", run, "--json")
    assert changed.returncode == EXIT_REFUSED
    files = {problem["file"] for problem in json.loads(changed.stdout)["problems"]}
    assert files == {"records/01-image.json", "note.txt"}


def foreign_record(run: Path) -> str:
    (run / "records" / "01-image.json").write_bytes(
        (run / "records" / "02-localization-T1.json").read_bytes()
    )
    return "records/01-image.json"


def line_removed(run: Path) -> str:
    lines = (run / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (run / "journal.jsonl").write_bytes(b"".join([*lines[:5], *lines[6:]]))
    return "journal.jsonl"


def record_gone(run: Path) -> str:
    (run / "records" / "01-image.json").unlink()
    return "records/01-image.json"


def request_changed(run: Path) -> str:
    path = run / REQUEST_FILE
    path.write_text(path.read_text() + " ")
    return REQUEST_FILE


def file_added(run: Path) -> str:
    (run / "note.txt").write_text("added")
    return "note.txt"


SPOILT = (foreign_record, line_removed, record_gone, request_changed, file_added)


@pytest.mark.hazard(39)
@pytest.mark.parametrize("spoil", SPOILT, ids=lambda spoil: spoil.__name__)
def test_every_command_names_the_changed_file_of_a_run(run: Path, spoil: Callable[[Path], str]) -> None:
    name = spoil(run)
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    relied_on = name.startswith((RECORDS_FOLDER, JOURNAL_FILE))  # by a replay
    for command in ("export", "resume", "lineage", "report", *["replay"] * relied_on):
        refused = in_this_process(app, command, run)
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


@pytest.mark.hazard(39)
def test_a_full_disk_while_sealing_a_run_loses_nothing(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / SEAL_FILE).unlink()
    with monkeypatch.context() as full:
        full.setattr(os, "fsync", lambda _file: (_ for _ in ()).throw(OSError(errno.ENOSPC, "disk full")))
        seal_run(run)
    assert "the run could not be sealed" in capsys.readouterr().err
    assert [problem.file for problem in inspected(run).problems] == [SEAL_FILE]
    refused = in_this_process(app, "export", run)
    assert refused.returncode == EXIT_REFUSED
    assert "is not finished: seal.json: missing" in refused.stderr
    seal_run(run)
    assert inspected(run).problems == ()


@pytest.mark.hazard(39)
@pytest.mark.parametrize("moment", ["write_report", "_take_over", "seal_run"])
def test_an_interrupted_report_does_not_leave_the_run_changed(
    run: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    where = written_report if moment == "write_report" else runs_report
    original = getattr(where, moment)

    def interrupted(*arguments: Any, **options: Any) -> None:
        if moment != "seal_run":
            original(*arguments, **options)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(where, moment, interrupted)
        with pytest.raises(KeyboardInterrupt):
            make_report(run)
    assert inspected(run).changes == ()
    assert make_report(run) == run / "report.html"
    assert inspected(run).problems == ()


def test_resume_reports_that_a_run_is_finished_and_keeps_its_recorded_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = new_run_folder(CaseRequest(out=tmp_path))
    cell = RecordingCell(folder)
    cell.journal.write(Entry.OPENED, 0.0, run=folder.name)
    cell.engine(plain_order()).close("done")
    keep_truth(folder, kept := Truth(targets=()))
    seal_run(folder)
    given: list[Truth | None] = []
    monkeypatch.setattr(runs_resume, "order_of_case", lambda *_: plain_order())
    monkeypatch.setattr(runs_resume, "finished", lambda *arguments: given.append(arguments[-1]))
    monkeypatch.setattr(runs_resume, "_with_report", lambda outcome, _folder: outcome)
    monkeypatch.setattr(runs_resume, "show_outcome", lambda *_, **__: None)
    runs_resume.resume(folder, accept=True, answers=None, as_json=False)
    assert given == [kept]
    assert f"{folder.name} is finished" in capsys.readouterr().err


def test_an_end_written_later_records_ct_and_plan_outside_the_run(tmp_path: Path) -> None:
    case, folder = tmp_path / "case", tmp_path / "run"
    (case / "ct").mkdir(parents=True)
    for name in ("ct/1.dcm", "plan.toml"):
        (case / name).write_text("as it was")
    cell = RecordingCell(folder)
    cell.engine(plain_order()).run_to()
    cell.journal.close()  # killed before its end
    request = CaseRequest(out=tmp_path, config=tmp_path / "theatre.toml", case=case)
    close_left(read_left_run(folder), clinical_input(request, folder))
    assert inspected(folder).changes == ()
    (case / "plan.toml").write_text("another")
    assert [str(one) for one in inspected(folder).changes] == [f"{case / 'plan.toml'}: changed"]


def test_lineage_shows_every_result_with_its_parents(run: Path) -> None:
    text = in_this_process(app, "lineage", run).stdout
    lines = text.splitlines()
    fit = next(number for number, line in enumerate(lines) if line.strip() == "05-fit-T1")
    assert lines[fit + 1].strip() == "04-localization-T1"
    assert "03-fit-T1 (superseded)" in text
    chart = in_this_process(app, "lineage", run, "--mermaid").stdout
    assert chart.startswith("flowchart TD")
    assert chart.count(":::superseded") == 2


def test_list_shows_how_a_run_ended_and_show_lists_its_results(run: Path) -> None:
    listed = json.loads(in_this_process(app, "list", run.parent, "--json").stdout)["runs"]
    assert [(one["run"], one["ended"]) for one in listed] == [(run.name, "done")]
    shown = json.loads(in_this_process(app, "show", run, "--json").stdout)
    assert shown["done"][0] == "image"
    assert sorted(shown["superseded"]) == ["02-localization-T1", "03-fit-T1"]
    assert run.name in in_this_process(app, "show", run).stdout
    assert run.name in in_this_process(app, "list", run.parent).stdout


@pytest.mark.parametrize("seal", [True, False], ids=["sealed", "seal removed"])
def test_list_omits_an_error_from_a_changed_file_and_names_the_file(run: Path, seal: bool) -> None:
    keep_truth(run, Truth(targets=(TargetTruth(id="T1", application_error_mm=1.25),)))
    seal_run(run)
    (row,) = json.loads(in_this_process(app, "list", run.parent, "--json").stdout)["runs"]
    assert (row["max_application_error_mm"], row["problems"]) == (1.25, [])
    keep_truth(run, Truth(targets=(TargetTruth(id="T1", application_error_mm=0.125),)))
    if not seal:
        (run / SEAL_FILE).unlink()
    (row,) = json.loads(in_this_process(app, "list", run.parent, "--json").stdout)["runs"]
    what = "changed" if seal else "not confirmed by a seal"
    assert (row["max_application_error_mm"], row["problems"]) == (None, [f"report/truth.json: {what}"])
    table = in_this_process(app, "list", run.parent).stdout
    assert "0.125" not in table
    assert f"{run.name} is not reliable: report/truth.json: {what}" in table


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
    told = in_this_process(app, "watch", run).stderr.splitlines()
    assert told[0] == "NOT AS THE RUN LEFT IT: events.jsonl: changed"


@pytest.mark.parametrize("which", [(), ("RUN", "--config", "theatre.toml")])
def test_acknowledge_requires_either_a_run_or_a_theatre(which: tuple[str, ...]) -> None:
    refused = in_this_process(app, "acknowledge", *which)
    assert refused.returncode == EXIT_USAGE
    one_error(refused.stderr)


@pytest.mark.parametrize("by", [(), ("--by", "007")])
def test_acknowledge_without_a_persons_name_is_refused(run: Path, by: tuple[str, ...]) -> None:
    refused = in_this_process(app, "acknowledge", run, *by)
    assert refused.returncode == EXIT_REFUSED
    assert one_error(refused.stderr)[0].startswith("DEV-006")


def test_home_has_nothing_to_do_when_the_arm_never_moved(tmp_path: Path) -> None:
    folder = new_run_folder(CaseRequest(out=tmp_path))
    done = in_this_process(app, "home", folder, "--json")
    assert json.loads(done.stdout) == {"run": folder.name, "home": True, "moved": False}


def test_acknowledge_on_a_finished_run_writes_nothing(run: Path) -> None:
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    done = in_this_process(app, "acknowledge", run, "--by", "A. Nurse")
    assert (done.returncode, done.stdout) == (0, "the run is finished\n")
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_acknowledge_prints_what_was_acknowledged_and_by_whom(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    cell = RecordingCell(tmp_path / "run")
    for device in (cell.tracker, cell.stereo):
        monkeypatch.setattr(device, "recover", lambda _by: None, raising=False)
    monkeypatch.setattr(Theatre, "from_file", lambda _file: cell.opened)
    done = in_this_process(app, "acknowledge", "--config", "theatre.toml", "--by", "A. Nurse")
    assert "acknowledged by A. Nurse: robot.master: " in done.stdout


def test_acknowledge_recovers_a_theatre_without_a_run_and_lists_unreachable_devices(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
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
