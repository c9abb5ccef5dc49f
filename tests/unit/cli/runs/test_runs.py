"""What commands show of a finished run, and what is left to do for it."""

from __future__ import annotations

import json
import os
from contextlib import nullcontext
from pathlib import Path

import pytest
import typer
from coded_errors import raises
from plain_steps import plain_order
from recording_cell import RecordingCell
from user_commands import in_this_process, one_error

from procedures.cli.ct import app as ct_app
from procedures.cli.procedure import app
from procedures.cli.runs import resume as runs_resume
from procedures.cli.runs import showing
from procedures.cli.runs.showing import draw_lineage
from procedures.journal.journal import ONLY_LEAVING, Entry
from procedures.reporting.kept_truth import load_truth, store_truth
from procedures.reporting.outcome import Truth
from procedures.runs import case_outcome
from procedures.runs.finishing import seal_run
from procedures.runs.folders import hold_run, new_run_folder
from procedures.runs.request import CaseProcedure, RunRequest
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.evidence.inspection import Inspection
from ronna_hw.evidence.journal_reading import JournalChain
from ronna_hw.evidence.manifest import Manifest, is_sealed
from ronna_hw.records import Record
from studies.cli import app as campaign_app


@pytest.mark.parametrize("sealed", [True, False])
def test_resume_reports_that_a_run_is_finished_and_keeps_its_recorded_truth_if_it_is_sealed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], sealed: bool
) -> None:
    folder = new_run_folder(RunRequest(procedure=CaseProcedure()), tmp_path)
    cell = RecordingCell(folder)
    cell.journal.write(Entry.OPENED, 0.0, run=folder.name)
    cell.engine(plain_order()).close("done")
    store_truth(folder, kept := Truth(targets=()))
    if sealed:
        seal_run(folder)
    given: list[Truth | None] = []
    monkeypatch.setattr(case_outcome, "restore_order", lambda *_: plain_order())
    monkeypatch.setattr(
        case_outcome, "build_finished_outcome", lambda *arguments: given.append(arguments[-1])
    )
    monkeypatch.setattr(case_outcome, "with_report", lambda outcome, _folder: outcome)
    monkeypatch.setattr(runs_resume, "with_report", lambda outcome, _folder: outcome)
    monkeypatch.setattr(runs_resume, "show_outcome", lambda *_, **__: None)
    runs_resume.resume(folder, accept=True, answers=None, as_json=False)
    assert given == [kept if sealed else None]
    assert load_truth(folder) == given[0]
    assert is_sealed(folder)
    assert f"{folder.name} is finished" in capsys.readouterr().err


def test_lineage_shows_every_result_with_its_parents(run: Path) -> None:
    text = in_this_process(app, "lineage", run).stdout
    lines = text.splitlines()
    fit = next(number for number, line in enumerate(lines) if line.strip() == "05-fit-T1")
    assert lines[fit + 1].strip() == "04-localization-T1"
    assert "03-fit-T1 (superseded)" in text
    chart = in_this_process(app, "lineage", run, "--mermaid").stdout
    assert chart.startswith("flowchart TD")
    assert chart.count(":::superseded") == 2


def test_lineage_of_a_long_chain_of_strange_names_is_drawn_without_control_characters(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    names = [f"{number}-\x1b[2J" for number in range(2000)]
    made = tuple(
        Record(name, "image", dict.fromkeys(parents, ""), {})
        for name, parents in zip(names, [[], *([one] for one in names)], strict=False)
    )
    found = Inspection(tmp_path, JournalChain(), Manifest(), made, ())
    monkeypatch.setattr(showing, "inspect_run", lambda folder: found)
    for as_mermaid in (False, True):
        draw_lineage(tmp_path, as_mermaid=as_mermaid)
        drawn = capsys.readouterr().out
        assert "\x1b" not in drawn
        assert "1999-" in drawn


def test_list_shows_how_a_run_ended_and_show_lists_its_results(run: Path) -> None:
    listed = json.loads(in_this_process(app, "list", run.parent, "--json").stdout)["runs"]
    assert [(one["run"], one["ended"]) for one in listed] == [(run.name, "done")]
    shown = json.loads(in_this_process(app, "show", run, "--json").stdout)
    assert shown["done"][0] == "image"
    assert sorted(shown["superseded"]) == ["02-localization-T1", "03-fit-T1"]
    assert run.name in in_this_process(app, "show", run).stdout
    assert run.name in in_this_process(app, "list", run.parent).stdout


def test_list_of_a_folder_without_runs_names_the_subfolders_that_hold_some(tmp_path: Path) -> None:
    new_run_folder(RunRequest(procedure=CaseProcedure()), tmp_path / "my runs")
    (tmp_path / "empty").mkdir()
    below = tmp_path / "my runs"
    assert in_this_process(app, "list", tmp_path).stdout.splitlines() == [
        f"no runs in {tmp_path}",
        f"{below} holds runs: ronna-procedure list '{below}'",
    ]
    assert in_this_process(app, "list", tmp_path / "empty").stdout == f"no runs in {tmp_path / 'empty'}\n"
    assert json.loads(in_this_process(app, "list", tmp_path, "--json").stdout) == {"runs": []}


def test_show_counts_a_restart_that_ran_no_step_apart_from_those_that_resumed_the_run(tmp_path: Path) -> None:
    folder = new_run_folder(RunRequest(procedure=CaseProcedure()), tmp_path)
    journal = RecordingCell(folder).journal
    journal.write(Entry.OPENED, 0.0, run=folder.name)
    for only_leaving in (True, True, False):
        journal.write(Entry.RESTARTED, 0.0, **({ONLY_LEAVING: True} if only_leaving else {}))
    journal.write(Entry.ACCEPTED, 0.0)
    shown = in_this_process(app, "show", folder).stdout
    assert "resumed 1 time\ntaken up 2 times only to go home, or to acknowledge a fault\n" in shown


@pytest.mark.parametrize(("held", "ended"), [(True, "running"), (False, "killed")])
def test_a_run_that_a_program_has_open_is_not_listed_as_killed(
    tmp_path: Path, held: bool, ended: str
) -> None:
    folder = new_run_folder(RunRequest(procedure=CaseProcedure()), tmp_path)
    RecordingCell(folder).journal.write(Entry.OPENED, 0.0, run=folder.name)
    with hold_run(folder) if held else nullcontext():
        (listed,) = json.loads(in_this_process(app, "list", tmp_path, "--json").stdout)["runs"]
        shown = in_this_process(app, "show", folder).stdout
    assert listed["ended"] == ended
    assert (f"(pid {os.getpid()}" in shown, "The program ended" in shown) == (held, not held)


def test_home_has_nothing_to_do_when_the_arm_never_moved(tmp_path: Path) -> None:
    folder = new_run_folder(RunRequest(procedure=CaseProcedure()), tmp_path)
    done = in_this_process(app, "home", folder, "--json")
    assert json.loads(done.stdout) == {"run": folder.name, "home": None, "moved": False}


@pytest.mark.parametrize("command", ["show", "verify", "report", "resume"])
def test_a_folder_of_runs_is_refused_with_the_name_of_the_run_in_it(tmp_path: Path, command: str) -> None:
    folder = new_run_folder(RunRequest(procedure=CaseProcedure()), tmp_path)
    (folder / "journal.jsonl").touch()
    done = in_this_process(app, command, tmp_path)
    shown = " ".join(one_error(done.stderr))
    assert f"CLI-005: {tmp_path} is not a run; it holds 1 run: {folder.name}" in shown
    assert f"Give one of them: {folder}." in shown


@pytest.mark.parametrize("mistyped", ["cases/{half}", "{half}", "case"])
def test_part_of_a_name_is_refused_with_the_only_run_it_may_mean(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mistyped: str
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = new_run_folder(RunRequest(procedure=CaseProcedure()), Path("cases"))
    (folder / "journal.jsonl").touch()
    done = in_this_process(app, "resume", mistyped.format(half=folder.name[:-5]))
    assert f"Did you mean {folder}?" in " ".join(one_error(done.stderr))


@pytest.mark.parametrize("inside", ["", "report", "new/folder"])
def test_nothing_is_written_into_a_run(run: Path, inside: str) -> None:
    before = sorted(run.rglob("*"))
    report = in_this_process(app, "report", run, "--out", run / inside)
    assert "CLI-005" in one_error(report.stderr)[0]
    export = in_this_process(app, "export", run, "--out", run / inside)
    assert "CLI-005" in one_error(export.stderr)[0]
    with raises(PATH_PROBLEM, match=r"the folder of a run|inside the run"):
        new_run_folder(RunRequest(procedure=CaseProcedure()), run / inside)
    assert sorted(run.rglob("*")) == before


@pytest.mark.parametrize(
    ("program", "words"),
    [
        (ct_app, ("localize", ".", "--write", "{run}/spheres.json")),
        (ct_app, ("localize", ".", "--pictures", "{run}/pictures")),
        (ct_app, ("view", ".", "--out", "{run}/ct.html")),
        (ct_app, ("postoperative", ".", ".", "--plan", "plan.toml", "--out", "{run}/after")),
        (campaign_app, ("registration", "--runs", "1", "--out", "{run}/study")),
    ],
)
def test_no_command_adds_a_file_to_a_run(run: Path, program: typer.Typer, words: tuple[str, ...]) -> None:
    before = sorted(run.rglob("*"))
    ended = in_this_process(program, *(word.format(run=run) for word in words))
    assert "CLI-005" in one_error(ended.stderr)[0]
    assert "inside the run" in ended.stderr
    assert sorted(run.rglob("*")) == before
