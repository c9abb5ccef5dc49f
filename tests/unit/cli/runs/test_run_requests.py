"""What a run folder records of its request, and which folders its commands refuse."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest
from coded_errors import raises
from recording_cell import mini_theatre_file
from user_commands import in_this_process, one_error

from procedures.cli.case import display, stepping
from procedures.cli.case.display import follow_case
from procedures.cli.case.options import CaseOptions
from procedures.cli.case.stepping import step_through
from procedures.cli.procedure import app
from procedures.cli.runs.commands import COMMANDS
from procedures.engine.errors import BAD_REQUEST_FILE, OTHER_PROGRAM
from procedures.engine.methods import CaseMethods, Matcher
from procedures.imaging.localizers import Localizer
from procedures.operator.errors import OperatorAborted
from procedures.runs.answers import Answers
from procedures.runs.case import clinical_input
from procedures.runs.folders import hold_run, new_run_folder
from procedures.runs.reopening import read_reopened_request
from procedures.runs.request import CalibrationProcedure, CaseProcedure, RunRequest, SceneChoice
from procedures.runs.request_file import REQUEST_FILE, read_request
from procedures.steps.calibration.recipe import Calibrated, Recipe
from ronna_hw.errors import EXIT_FAILED, EXIT_RECOVERY_NEEDED, EXIT_REFUSED, EXIT_USAGE


def test_the_request_is_the_first_file_and_records_what_was_asked_for(tmp_path: Path) -> None:
    asked = RunRequest(
        procedure=CaseProcedure(strategy="nos"),
        choice=SceneChoice("mini", 7, 4),
        speed="1",
        faults=Path("/a/b.txt"),
        ask=True,
    )
    folder = new_run_folder(asked, tmp_path)
    assert [path.name for path in folder.iterdir()] == [REQUEST_FILE]
    assert read_request(folder) == asked


def test_a_run_begun_with_ask_is_resumed_at_a_terminal_only(tmp_path: Path) -> None:
    asked = RunRequest(procedure=CaseProcedure(), choice=SceneChoice("mini", 0, 0), ask=True)
    folder = new_run_folder(asked, tmp_path)
    refused = in_this_process(app, "resume", folder)
    assert refused.returncode == EXIT_USAGE
    (line,) = one_error(refused.stderr)
    assert f"{folder.name} was begun with --ask" in line
    assert "Nothing was moved. Run the command at a terminal" in line


OF_THE_THESIS = CaseMethods(
    localizer=Localizer.THESIS_LINE,
    matcher=Matcher.THESIS,
    e_mm=3.5,
    refused_share=0.015,
    enhance_contrast=True,
)


def test_a_resumed_run_goes_on_with_the_methods_of_its_start(tmp_path: Path) -> None:
    given = CaseOptions(
        sim=True,
        localizer=Localizer.THESIS_LINE,
        matcher=Matcher.THESIS,
        matcher_e_mm=3.5,
        matcher_refused_share=0.015,
        enhance_contrast=True,
    )
    folder = new_run_folder(given.request(), tmp_path)
    assert read_request(folder).case.methods == OF_THE_THESIS
    assert clinical_input(read_request(folder).case, folder).methods == OF_THE_THESIS


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"methods": {"localizer": "thesis"}}, "methods.localizer"),
        ({"methods": {"sigma": 1.0}}, "methods.sigma"),
        ({"answers": {"default": "yes"}}, "default"),
    ],
)
def test_methods_and_answers_in_a_request_that_do_not_exist_are_refused(
    tmp_path: Path, changed: dict[str, object], named: str
) -> None:
    folder = new_run_folder(RunRequest(procedure=CaseProcedure()), tmp_path)
    path = folder / REQUEST_FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))
    with raises(BAD_REQUEST_FILE, match=f"PRO-034: .*{named}"):
        read_request(folder)


@pytest.mark.parametrize(
    ("setting", "value", "said"),
    [("e_mm", 9.0, "limit 1 to 6 mm, got 9 mm"), ("refused_share", 0.9, "limit 1e-06 to 0.5, got 0.9")],
)
def test_settings_of_the_thesis_matcher_out_of_range_are_refused_as_the_request_is_read(
    tmp_path: Path, setting: str, value: float, said: str
) -> None:
    folder = new_run_folder(RunRequest(procedure=CaseProcedure()), tmp_path)
    path = folder / REQUEST_FILE
    content = json.loads(path.read_text())
    content["methods"] |= {"matcher": "thesis", setting: value}
    path.write_text(json.dumps(content))
    with raises(BAD_REQUEST_FILE) as refused:
        read_request(folder)
    assert refused.value.code == "PRO-034"
    assert said in refused.value.summary
    assert "REG-007" in refused.value.summary


def test_a_resumed_run_is_answered_by_the_file_of_its_start_unless_given_another(tmp_path: Path) -> None:
    asked = RunRequest(
        procedure=CaseProcedure(), answers=Answers(default="first", answers={"approach:T1": "no"})
    )
    folder = new_run_folder(asked, tmp_path)
    assert read_request(folder) == asked
    assert read_reopened_request(folder, reuse_answers=True).answers == asked.answers
    other = tmp_path / "other.toml"
    other.write_text('default = "silence"')
    assert read_reopened_request(folder, answers=other, reuse_answers=True).answers == Answers(
        default="silence"
    )


def test_the_answers_of_a_case_do_not_answer_for_the_way_home(tmp_path: Path) -> None:
    folder = new_run_folder(RunRequest(procedure=CaseProcedure(), answers=Answers(default="first")), tmp_path)
    assert read_reopened_request(folder).answers is None


def test_the_reopened_request_a_calibration_records_the_recipe_of_its_steps(tmp_path: Path) -> None:
    recipe = Recipe(of=Calibrated.TIP, looks=8, more=3, ball_mm=(500.0, 0.0, 200.0)).model_dump(mode="json")
    asked = RunRequest(
        procedure=CalibrationProcedure(recipe=recipe, days=30, update=True),
        choice=SceneChoice("mini", 7, first_day=True),
    )
    folder = new_run_folder(asked, tmp_path, "tool-tip")
    assert [path.name for path in folder.iterdir()] == [REQUEST_FILE]
    assert read_request(folder) == asked
    refused = in_this_process(app, "resume", folder, "--accept", "--console")
    assert refused.returncode == EXIT_USAGE
    assert "--console operates cases" in one_error(refused.stderr)[0]


@pytest.mark.hazard(2)
def test_resume_refuses_a_run_of_another_version(tmp_path: Path) -> None:
    folder = new_run_folder(RunRequest(procedure=CaseProcedure()), tmp_path)
    path = folder / REQUEST_FILE
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"program": "0.0.1"}))
    with raises(OTHER_PROGRAM, match="PRO-031"):
        read_request(folder)
    refused = in_this_process(app, "resume", folder, "--accept")
    assert refused.returncode == EXIT_RECOVERY_NEEDED
    one_error(refused.stderr)


@pytest.mark.parametrize("content", [None, "", '{"schema": 1}', "\0\0\0"])
def test_a_folder_that_is_not_a_run_is_refused(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / REQUEST_FILE).write_text(content)
    with raises(BAD_REQUEST_FILE, match="PRO-034"):
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
    folder = new_run_folder(RunRequest(procedure=CaseProcedure()), tmp_path)
    with hold_run(folder):
        refused = in_this_process(app, *command, folder)
    assert refused.returncode == EXIT_REFUSED
    assert "PRO-030" in refused.stderr


@pytest.mark.hazard(42)
@pytest.mark.parametrize(("lead", "options"), [(follow_case, {"as_json": False}), (step_through, {})])
def test_a_command_that_drives_a_case_locks_its_run_before_opening_anything(
    tmp_path: Path, lead: Callable[..., None], options: dict[str, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    refused: list[int] = []

    def opened(_request: RunRequest, folder: Path, *_: object) -> NoReturn:
        refused.append(in_this_process(app, "resume", folder, "--accept").returncode)
        raise OperatorAborted("seen enough")

    monkeypatch.setattr(display, "run_case", opened)
    monkeypatch.setattr(stepping, "open_run", opened)
    with pytest.raises(OperatorAborted):
        lead(RunRequest(procedure=CaseProcedure()), tmp_path, **options)
    assert refused == [EXIT_REFUSED]


@pytest.mark.parametrize("command", ["resume", "home"])
def test_the_accept_option_is_refused_on_real_devices(tmp_path: Path, command: str) -> None:
    theatre = mini_theatre_file(tmp_path, simulated=False)
    folder = new_run_folder(RunRequest(procedure=CaseProcedure(case=tmp_path), config=theatre), tmp_path)
    refused = in_this_process(app, command, folder, "--accept")
    assert refused.returncode == EXIT_USAGE
    assert "--accept is for a simulated theatre" in one_error(refused.stderr)[0]


def test_a_run_in_a_simulated_theatre_of_its_own_file_may_be_accepted_by_option(tmp_path: Path) -> None:
    asked = RunRequest(
        procedure=CaseProcedure(case=tmp_path), config=mini_theatre_file(tmp_path, simulated=True)
    )
    assert read_reopened_request(new_run_folder(asked, tmp_path), accept=True) == asked
