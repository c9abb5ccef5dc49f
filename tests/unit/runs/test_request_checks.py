"""What is checked before a run folder is made: fault script, the plan's patient, free space."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from painted_ct import SERIES_UID, write_series
from prepared_results import plan
from pydicom.dataset import Dataset

from procedures.engine.methods import CaseMethods, Matcher
from procedures.imaging.localizers import Localizer
from procedures.journal import free_space
from procedures.planning.errors import WRONG_SERIES
from procedures.planning.plan_file import write_plan
from procedures.planning.plan_model import FiducialKind
from procedures.runs import request_checks
from procedures.runs.fault_script import check_fault_script, list_unreached_faults
from procedures.runs.request import CaseProcedure, RunRequest, SceneChoice
from procedures.runs.request_checks import (
    require_fitting_options,
    require_simulated_patient,
    require_space,
)
from procedures.strategies.names import STRATEGY_NAMES
from ronna_hw.command_line.errors import DISK_FULL, UsageMistake
from ronna_hw.control_port import TRUTH_IS_TOLD
from ronna_hw.errors import EXIT_USAGE
from ronna_hw.roles import TWO_ARMS

STEPS = ("registration", "at_target")


def _script(folder: Path, text: str) -> Path:
    path = folder / "faults.txt"
    path.write_text(text)
    return path


def test_known_steps_are_accepted_with_and_without_a_target(tmp_path: Path) -> None:
    check_fault_script(
        _script(
            tmp_path,
            "at 1 s: robot drop 5 % for 1 s\n"
            "when step == registration: robot drop 5 % for 1 s  # when step == tea\n"
            "  when step==at_target:T1: camera drop 1 %\n",
        ),
        STEPS,
    )


def test_every_unknown_step_is_reported_with_its_line_and_the_known_steps(tmp_path: Path) -> None:
    text = "when step == tea: robot drop 5 %\n\nwhen step == at_targets:T1: robot drop 5 %\n"
    with pytest.raises(UsageMistake) as caught:
        check_fault_script(_script(tmp_path, text), STEPS)
    message = str(caught.value)
    assert "line 1: there is no step 'tea'; line 3: there is no step 'at_targets'" in message
    assert "expected at_target, or another of registration" in message


def test_a_fault_in_a_step_of_one_trajectory_is_refused_where_the_step_runs_once(tmp_path: Path) -> None:
    script = _script(tmp_path, "since step == surface_start:T1: room shift head 1 0 0 mm\n")
    request = RunRequest(
        procedure=CaseProcedure(), choice=SceneChoice("mini", fiducials="surface"), faults=script
    )
    with pytest.raises(UsageMistake, match="'surface_start' runs once for all trajectories, not for T1"):
        request_checks.check_case(request, tmp_path / "runs")


def test_a_line_that_the_theatre_cannot_read_is_refused_with_the_theatres_code_and_words(
    tmp_path: Path,
) -> None:
    script = _script(tmp_path, "since step == registration after 5: room shift head 0 2 0 mm\n")
    request = RunRequest(procedure=CaseProcedure(), choice=SceneChoice("mini"), faults=script)
    with pytest.raises(UsageMistake) as caught:
        request_checks.check_case(request, tmp_path / "runs")
    assert str(caught.value).startswith("SIM-003: faults.txt, line 1, column 35: expected 's', got ':'. ")
    assert caught.value.exit_code == EXIT_USAGE


def test_a_missing_script_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageMistake, match="there is no fault script"):
        check_fault_script(tmp_path / "none.txt", STEPS)


def test_a_fault_whose_step_or_time_the_case_did_not_reach_is_named_at_its_end(tmp_path: Path) -> None:
    text = (
        "at 12.5 s: robot drop 5 %\n"
        "at 99999 s: robot drop 5 %\n"
        "when step == at_target: robot drop 5 %\n"
        "when step == at_target:T1: robot drop 5 %\n"
        "since step == at_target:T9: room shift cart 0 2 0 mm\n"
        "at cycle 500: robot drop 5 %\n"
    )
    assert [*list_unreached_faults(_script(tmp_path, text), ("registration", "at_target:T1"), 60.04)] == [
        "line 2 of faults.txt had no effect: the case ended after 60.0 s",
        "line 5 of faults.txt had no effect: the case did not run at_target:T9",
    ]


def _plan_beside_a_scan_of(folder: Path, patient: str) -> Path:
    def name(data: Dataset, _: int) -> None:
        data.PatientID = patient

    write_series(folder / "ct", np.zeros((1, 4, 4), np.int16), edit=name)
    return folder / "plan.toml"


@pytest.mark.parametrize(
    ("choice", "added"),
    [(SceneChoice("mini", seed=7), "--seed 4"), (SceneChoice("default", seed=4), "--scene mini --seed 4")],
)
def test_a_plan_of_another_simulated_patient_names_the_options_of_its_own(
    tmp_path: Path, choice: SceneChoice, added: str
) -> None:
    plan = _plan_beside_a_scan_of(tmp_path, "mini-4")
    with raises(WRONG_SERIES) as caught:
        require_simulated_patient(plan, SERIES_UID, choice)
    assert caught.value.action == f"For its own patient add {added}."


@pytest.mark.parametrize(
    ("patient", "series"), [("mini-7", SERIES_UID), ("mini-4", "2.25.1"), ("A-4", SERIES_UID)]
)
def test_a_plan_of_this_patient_or_of_nobody_known_is_left_to_the_import(
    tmp_path: Path, patient: str, series: str
) -> None:
    require_simulated_patient(_plan_beside_a_scan_of(tmp_path, patient), series, SceneChoice("mini", seed=7))


def test_a_case_is_not_started_on_a_disk_without_room_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    require_space(tmp_path / "runs")
    monkeypatch.setattr(
        request_checks, "describe_shortage", lambda folder: free_space.describe_shortage(folder, 10**18)
    )
    with raises(DISK_FULL) as caught:
        require_space(tmp_path / "runs" / "deep")
    assert str(tmp_path) in caught.value.what


@pytest.mark.parametrize(
    ("name", "text", "seed"),
    [
        ("scene.toml", "seed = 4\n", 4),
        ("scene.json", '{"seed": 4}', 4),
        ("scene.toml", "seed = ", 0),  # invalid
        ("scene.toml", "seed = [1]\n", 0),
    ],
)
def test_a_scene_file_brings_its_own_seed_and_a_built_in_scene_takes_the_requested_one(
    tmp_path: Path, name: str, text: str, seed: int
) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert SceneChoice(str(tmp_path / name)).scene_seed == seed
    assert SceneChoice("mini", seed=7).scene_seed == 7


@pytest.mark.parametrize("fiducials", ["free", "mixed"])
def test_single_spheres_are_refused_beside_a_tracker_that_sends_tools_alone(fiducials: str) -> None:
    words = f"--tracker plus sends tools alone.*{fiducials}.*; expected .* Add --fiducials xframe or surface"
    with raises(UsageMistake, match=words):
        SceneChoice("mini", fiducials=fiducials, tracker="plus").check()
    for possible in ("xframe", "surface"):
        SceneChoice("mini", fiducials=possible, tracker="plus").check()


def test_theatre_and_patient_are_made_for_the_chosen_arm() -> None:
    assert SceneChoice("mini", arm="ur5e").arguments()[-2:] == ["--arm", "ur5e"]
    assert "--arm" not in SceneChoice("mini").arguments()


def test_a_case_on_configured_endpoints_has_no_seed(tmp_path: Path) -> None:
    assert RunRequest(procedure=CaseProcedure()).seed == 0
    assert RunRequest(procedure=CaseProcedure(), config=tmp_path / "theatre.toml").seed is None


def test_no_run_is_accepted_in_a_theatre_that_tells_the_truth(tmp_path: Path) -> None:
    config = tmp_path / "theatre.toml"
    config.write_text('theatre = "simulated"\ntells_truth = true\n')
    request = RunRequest(config=config)
    with raises(TRUTH_IS_TOLD):
        request_checks.check_theatre(request)
    config.write_text('theatre = "simulated"\n')
    request_checks.check_theatre(request)


@pytest.mark.parametrize(
    ("case", "fiducials", "words"),
    [
        (CaseProcedure(roles=TWO_ARMS), FiducialKind.MIXED, "--dual and fiducials mixed cannot be combined"),
        (CaseProcedure(intraoperative=True), FiducialKind.SURFACE, "--intraoperative and fiducials surface"),
        (CaseProcedure(strategy="nos"), FiducialKind.SURFACE, "--strategy nos has no effect"),
        (
            CaseProcedure(methods=CaseMethods(localizer=Localizer.THESIS_LINE)),
            FiducialKind.SURFACE,
            "--localizer thesis-line has no effect",
        ),
        (
            CaseProcedure(methods=CaseMethods(matcher=Matcher.THESIS)),
            FiducialKind.MIXED,
            "--matcher thesis has no effect",
        ),
        (
            CaseProcedure(methods=CaseMethods(enhance_contrast=True)),
            FiducialKind.SURFACE,
            "--enhance-contrast has no effect",
        ),
    ],
)
def test_options_that_mean_nothing_with_a_scan_of_the_skin_are_refused(
    case: CaseProcedure, fiducials: FiducialKind, words: str
) -> None:
    with raises(UsageMistake, match=f"CLI-001: {words}.*; expected .* Omit --"):
        require_fitting_options(case, fiducials)
    require_fitting_options(case, FiducialKind.FREE)


@pytest.mark.parametrize(
    ("planned", "given"), [("free", "mixed"), ("mixed", "surface"), ("surface", "free"), ("xframe", "free")]
)
def test_a_plan_for_other_fiducials_than_the_patient_has_is_refused(
    tmp_path: Path, planned: str, given: str
) -> None:
    kind, file = FiducialKind(planned), tmp_path / "plan.toml"
    count = min(4, kind.fewest_and_most[1])
    write_plan(file, plan().model_copy(update={"fiducials": kind, "implanted": count}))

    def check(choice: SceneChoice) -> None:
        request = RunRequest(procedure=CaseProcedure(plan=file), choice=choice)
        request_checks.check_case(request, tmp_path / "runs")

    words = f"plan.toml has fiducials {planned}, and the simulated patient --fiducials {given}"
    with pytest.raises(UsageMistake, match=rf"CLI-001: {words}.*Add --fiducials {planned}, or write"):
        check(SceneChoice("mini", fiducials=given))
    check(SceneChoice("mini", fiducials=planned))


@pytest.mark.parametrize("strategy", STRATEGY_NAMES)
def test_every_strategy_looks_at_spheres_beside_the_skin(strategy: str) -> None:
    require_fitting_options(CaseProcedure(strategy=strategy), FiducialKind.MIXED)


def test_a_fault_in_a_step_at_spheres_is_refused_for_a_case_on_the_skin(tmp_path: Path) -> None:
    script = _script(tmp_path, "when step == relocalization: robot drop 5 %\n")
    request = RunRequest(
        procedure=CaseProcedure(), choice=SceneChoice("mini", fiducials="surface"), faults=script
    )
    with pytest.raises(UsageMistake, match=r"no step 'relocalization'.*surface_scan.*--fiducials"):
        request_checks.check_case(request, tmp_path / "runs")
