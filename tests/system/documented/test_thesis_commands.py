"""Every command of the thesis' table is run; those listed with figures give about what their rows state.

Most run in a small size: the figure then has a wide range, and a broken command or method is still found. The
figures themselves are those of the kept results (`tests/unit/docs/test_stated_figures.py`). Of `STUDIES`,
those in `ONLY_RUN` have no figure to compare; `CASES` are judged by the error at the target alone; tests
named in `ELSEWHERE` judge what they say, which often is not the row.
"""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import pytest
from stated_figures import ROOT, read_value
from thesis_table import commands as commands_of_the_table
from undisturbed import finished_mini
from user_commands import Commands, in_this_process

from ronna_hw.command_line.launch import COMMANDS

SMALL = ("--workers", "1")
HANGS_S = 3600.0  # on a shared machine; the longest takes 80 s of processor
SHOWN = "stdout.json"  # what a command prints, as JSON or TOML


@dataclass(frozen=True)
class Figure:
    """A value of a command's output, by its address, and the range in which it must be."""

    file: str
    address: str
    least: float
    most: float


@dataclass(frozen=True)
class Trial:
    """Options that make a command small, the files it writes, and figures in them."""

    options: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = ()
    is_slow: bool = False


RIGID = "formulas-of-the-rigid-fit.csv"
PARTS = "registration-and-arm-in-the-error-at-the-target.csv"
EQUATIONS, PRINTED, GAINS = (
    f"{name}.csv"
    for name in ("equations-of-chapter-2", "figures-printed-below-the-rows", "gains-from-the-printed-figures")
)
TEMPLATE = "markers-implanted-by-a-template.csv"
NORM = "correspondence-noise-norm.csv"
TOGETHER = "five-to-eight-fiducials-together.csv"
OCS_MM = 0.6  # at a target, with an uncalibrated arm: three times the usual


def case(*options: str, largest_mm: float = OCS_MM) -> Trial:
    """A whole case of the mini scene, whose only target is reached within this distance."""
    scene = () if "--scene" in options else ("--scene", "mini")
    error = Figure(SHOWN, "max_application_error_mm", 0.0, largest_mm)
    return Trial((*scene, *options, "--json"), (), (error,), is_slow=True)


STUDIES: Mapping[str, Trial] = {
    "ronna-campaign registration --runs 6000 --seed 76": Trial(
        ("--runs", "300", *SMALL),
        ("fre-and-tre.png",),
        (
            Figure(RIGID, "min::FLE by eq. 36 / true", 0.93, 1.0),
            Figure(RIGID, "max::FLE by eq. 36 / true", 1.0, 1.07),
            Figure(RIGID, "max::one space by eq. 37, 38 / true", 0.93, 1.07),
            Figure(RIGID, "min::TRE / eq. 39", 0.9, 1.05),  # of 300 runs, all may be above 1
            Figure(RIGID, "max::TRE / eq. 39", 1.0, 1.1),
            Figure(RIGID, "min::r of FRE and TRE", -0.2, 0.1),
            Figure(RIGID, "max::r of FRE and TRE", -0.1, 0.2),
        ),
    ),
    "ronna-campaign error-parts --arms 100 --seed 76": Trial(
        ("--arms", "6", *SMALL),
        ("fre-and-error.png", "error-and-distance.png"),
        (
            Figure(PARTS, "row:strategy=ocs:error mm", 0.15, 0.45),
            Figure(PARTS, "row:strategy=nos:error mm", 0.8, 3.0),
            Figure(PARTS, "row:strategy=ocs:registration mm", 1.5, 7.0),
            Figure(PARTS, "row:strategy=ocs:arm mm", 1.5, 7.0),
            Figure(PARTS, "row:strategy=ocs:cosine", -1.0, -0.97),
        ),
        is_slow=True,
    ),
    "ronna-campaign figures": Trial(
        (),
        ("figure-4-paired-points.png", "figure-5-principal-axes.png", "figure-6-closest-points.png"),
        is_slow=True,
    ),
    "ronna-campaign equations": Trial(
        (),
        (),
        (
            Figure(EQUATIONS, "row:equation=1 to 3:largest difference", 0.0, 1e-9),
            Figure(EQUATIONS, "row:equation=35:largest difference", 0.0, 1e-9),
            Figure(EQUATIONS, "row:equation=39:largest difference", 0.0, 1e-9),
            Figure(
                EQUATIONS, "row:equation=3, last form as printed, without R:largest difference", 175.0, 177.0
            ),
            Figure(EQUATIONS, "row:equation=15:largest difference", 0.0, 1e-12),
            Figure(EQUATIONS, "row:equation=16:largest difference", 0.0, 1e-12),
            Figure(EQUATIONS, "row:equation=17 and 18:largest difference", 0.0, 1e-12),
            Figure(EQUATIONS, "row:equation=19, with r12:largest difference", 0.0, 1e-12),
            Figure(EQUATIONS, "row:equation=19, as printed with r13:largest difference", 0.0505, 0.0515),
            Figure(EQUATIONS, "max:equation=21 to 31;unit=rad:largest difference", 0.0, 1e-10),
            Figure(PRINTED, "row:table=3;column=average operator:differs by mm", 0.0096, 0.0098),
            Figure(GAINS, "row:table=2:gain of SphereFit over people %", 49.285, 49.295),
            Figure(GAINS, "row:table=3:gain of SphereFit over people %", 45.905, 45.915),
        ),
    ),
    "ronna-campaign correspondence": Trial(
        ("--runs", "1", *SMALL),
        (),
        (Figure(TOGETHER, "max:noise=norm;method=clique + planned count:false %", 0.0, 0.0),),
    ),
    "ronna-campaign correspondence --method thesis-validated --e 1.5 --seed 47": Trial(
        ("--runs", "20", *SMALL),
        (),
        (
            Figure(NORM, "row:fiducials=3:unsuccessful %", 6.0, 18.0),
            Figure(NORM, "row:fiducials=4:unsuccessful %", 1.5, 8.0),
            Figure(NORM, "max::false %", 0.0, 1.0),
        ),
    ),
    "ronna-campaign correspondence --method thesis --method thesis-validated --e 1.5 --seed 47": Trial(
        ("--runs", "8", *SMALL),
        (),
        (
            Figure(NORM, "row:method=thesis;fiducials=3:unsuccessful %", 5.0, 20.0),
            Figure(NORM, "row:method=thesis, validated;fiducials=3:unsuccessful %", 5.0, 20.0),
            Figure(NORM, "max::false %", 0.0, 1.5),
        ),
    ),
    "ronna-campaign correspondence --method gradual-validated": Trial(
        ("--e", "1.5", "--runs", "8", *SMALL),
        (),
        (Figure(NORM, "row:fiducials=4;e mm=1.5:unsuccessful %", 0.5, 10.0),),
    ),
    "ronna-campaign correspondence --template": Trial(
        ("--runs", "2", *SMALL),
        (),
        (Figure(TEMPLATE, "max:markers=4:unsuccessful %", 0.0, 0.0),),
    ),
    "ronna-campaign correspondence --sweep --method thesis-validated --runs 100 --seed 47": Trial(
        ("--runs", "1", *SMALL), ("figure-13-norm.png", "figure-13-per-axis.png"), is_slow=True
    ),
    "ronna-campaign correspondence --xframe --seed 47": Trial(("--runs", "30", *SMALL), is_slow=True),
    "ronna-campaign localization --thesis": Trial(
        SMALL,
        (),
        (
            Figure("report.md", "min:method=combined:found", 52.0, 64.0),
            Figure("report.md", "max::false", 0.0, 0.0),
            Figure(
                "report.md",
                "row:method=thesis-sphere;scale errors up to %=0.6667:eq. 36, to the truth",
                0.7 * 0.1617,
                1.3 * 0.1617,
            ),
        ),
        is_slow=True,
    ),
    "ronna-campaign localization --frames": Trial(
        ("--sets", "1", *SMALL),
        (),
        (Figure("report.md", "row:who=combined:FLE mm, truth", 0.0, 0.015),),
        is_slow=True,
    ),
    "ronna-sim scene": Trial(("--scene", "mini"), (), (Figure(SHOWN, "arm.encoder_step_rad", 0.0, 0.0),)),
    "ronna-sim scene --patient-frame": Trial(
        ("--scene", "mini"),
        (),
        (Figure(SHOWN, "head.robot_from_patient_frame.translation_mm.0", 0.0, 2000.0),),
    ),
}
ONLY_RUN = {
    "ronna-campaign figures",
    "ronna-campaign correspondence --sweep --method thesis-validated --runs 100 --seed 47",
    "ronna-campaign correspondence --xframe --seed 47",
}
CASES: Mapping[str, Trial] = {
    "ronna-procedure run --sim --seed 7": Trial(
        ("--json",),
        (),
        tuple(
            Figure(SHOWN, f"targets.{number}.application_error_mm", error_mm - 0.1, error_mm + 0.1)
            for number, error_mm in enumerate(
                (0.103, 0.146, 0.110)
            )  # another processor may take one more look
        ),
        is_slow=True,
    ),
    "ronna-procedure run --sim --arm ur5 --scene mini": case(),
    "ronna-procedure run --sim --localizer thesis-sphere": case("--markers", "5", largest_mm=1.0),
    "ronna-procedure run --sim --localizer thesis-line": case("--markers", "5", largest_mm=1.0),
    "ronna-procedure run --sim --matcher thesis": case("--markers", "5", largest_mm=1.0),
    "ronna-procedure run --sim --scene mini --enhance-contrast": case(),
    "ronna-procedure run --sim --strategy nos": case(largest_mm=5.0),
    # its row states cases of five spheres; with the mini scene's three, 0.56 mm rms are predicted
    "ronna-procedure run --sim --strategy thesis-ocs": case("--markers", "5"),
    "ronna-procedure run --sim --strategy jdms": case(),
    "ronna-procedure run --sim --strategy improved --calibrated": case(largest_mm=0.35),
    "ronna-procedure run --sim --strategy learning": case(),
    "ronna-procedure run --sim --scene mini --dual --drill --seed 1": case(largest_mm=0.35),
}
OF_A_RUN: Mapping[str, str] = {  # of the mini case: what they print
    "ronna-procedure report RUN": r"report\.html",
    "ronna-sim verify RUN": r"registration mm\s+arm mm",
    "ronna-campaign times RUN": r"28\.8",
}
# Run by other tests, whose surroundings they need: a theatre, a browser, hours.
ELSEWHERE: Mapping[str, str] = {
    "ronna-stereo calibrate --config FILE": "tests/system/commands/test_stereo_commands.py::"
    "test_over_the_wire_the_tool_centre_is_within_three_hundredths_of_a_millimetre",
    "ronna-procedure calibrate tool-tip --sim --scene mini --out DIR": "tests/system/commands/"
    "test_mount_calibrations.py::test_the_page_about_the_tip_works",
    "ronna-plan place PLAN --ct DIR --config FILE --robot-from-ct 0 0 0 0 0 0": "tests/system/commands/"
    "test_place_command.py::test_the_proposed_position_is_drawn_and_passes_the_path_check",
    "ronna-sim move cart --by 40 -20 0 --turn 3": "tests/system/case/test_cart_moves.py::"
    "test_after_a_cart_was_wheeled_away_the_case_registers_again_and_reaches_its_targets",
    "ronna-procedure run --sim --dual --seed 7": "tests/system/robot/test_case_with_two_arms.py::"
    "test_the_assistant_inserts_the_instrument_both_arms_go_home_and_the_run_replays",
    "ronna-plan markers PLAN --ct DIR --out FILE": "tests/system/commands/test_plan_command.py::"
    "test_markers_are_proposed_only_on_the_head_of_the_plan",
    "ronna-sim phantom --out DIR": "tests/system/commands/test_phantom_command.py::"
    "test_every_sphere_is_found_at_its_true_position",
    "ronna-ct localize DIR --method thesis-line": "tests/system/commands/test_ct_command.py::"
    "test_the_thesis_methods_can_be_chosen_but_refine_no_picks",
    "ronna-ct localize DIR --method thesis-sphere": "tests/system/commands/test_ct_command.py::"
    "test_the_thesis_methods_can_be_chosen_but_refine_no_picks",
    "ronna-ct localize DIR --layout FILE": "tests/system/commands/test_ct_command.py::"
    "test_the_layout_is_found_beside_a_ball_of_another_size_which_is_told",
    "ronna-ct localize DIR --pick FILE": "tests/system/commands/test_ct_command.py::"
    "test_rough_picks_are_refined_and_flagged",
    "ronna-plan check PLAN --ct DIR": "tests/system/commands/test_plan_command.py::"
    "test_a_good_plan_is_accepted_with_a_table",
    "ronna-arm calibrate --sim --scene mini --out DIR": "tests/system/commands/test_arm_commands.py::"
    "test_a_simulated_theatre_is_calibrated_and_checked",
    "ronna-procedure calibrate tracker-frame --sim --scene mini --out DIR": "tests/system/commands/"
    "test_mount_calibrations.py::test_the_page_about_the_reference_frame_works",
    "ronna-procedure run --sim --scene mini --fiducials xframe": "tests/system/case/test_frame_cases.py::"
    "test_a_case_with_the_x_shaped_frame_reaches_its_target",
    "ronna-campaign application-error --arms 200 --seed 595993": "tests/unit/studies/test_accuracy.py::"
    "test_published_ronna_g3_errors_are_shown_next_to_their_own_markers_and_strategy",
    "ronna-campaign strategies": "tests/unit/studies/test_accuracy.py::"
    "test_the_study_shows_its_results_next_to_table_4_of_the_thesis",
    "ronna-campaign strategies --one-experiment": "tests/unit/studies/test_one_experiment.py::"
    "test_an_arm_fitted_to_table_4_shows_its_means_in_the_full_simulation",
    "ronna-campaign strategies --learning --arms 12 --seed 42986": "tests/unit/studies/"
    "test_learning_study.py::test_learning_is_nearer_with_no_more_looks_than_ocs_whatever_the_size_of_the_errors",
    "ronna-procedure run --sim --scene mini --fiducials surface": "tests/system/case/"
    "test_case_without_markers.py::"
    "test_a_case_on_the_skin_reaches_its_target_within_its_predicted_error",
    "ronna-campaign surface --heads 334 --seed 63872": "tests/unit/studies/test_surface_study.py::"
    "test_a_registration_is_judged_at_its_targets_and_the_same_unit_gives_the_same",
    "python -m benchmarks.surface.same_clouds --python PEERS/bin/python --heads 1": "tests/unit/registration/"
    "surface/test_surface_registration.py::test_closest_points_of_the_thesis_register_the_same_scan",
    "make bench ONLY=tool-tip": "tests/unit/calibration/test_tip_calibration.py::"
    "test_the_tip_is_found_relative_to_what_the_head_sees_whatever_the_arm",
    "make bench": "tests/unit/benchmarks/test_bench.py::"
    "test_one_measurement_prints_a_table_and_writes_its_figures",
    "ronna-plan open DIR": "tests/system/commands/test_plan_command.py::"
    "test_a_planner_whose_port_is_in_use_reports_it_and_leaves_the_plan_unchanged",
    "ronna-campaign low-cost --seed 0 --targets 30": "tests/system/commands/test_campaign_command.py::"
    "test_a_low_cost_theatre_positions_its_tool_on_feedback",
}
WARM_ARM = "ronna-procedure run --sim --scene FILE"  # errors that are off by default
WARM_VALUES = {
    "thermal_drift_mm": 0.05,
    "thermal_growth": 6.0e-5,
    "thermal_time_s": 30.0,
    "encoder_step_rad": 2.0e-5,
}
ADHESIVE = ("ronna-sim phantom --fiducials adhesive --out DIR", "ronna-ct adhesive DIR")
SERIES = "ronna-campaign localization --series DIR"
INSERTED = (
    Figure("report.md", "min:post=polymer:found", 5.0, 6.0),
    Figure("report.md", "max:post=polymer:rms µm", 0.0, 15.0),
    Figure("report.md", "max:post=all:rms µm", 0.0, 40.0),
    Figure("report.md", "max:post=all:false", 0.0, 0.0),
)


def test_every_command_of_the_table_is_run_here_or_by_a_test_that_exists() -> None:
    run = {*STUDIES, *CASES, *OF_A_RUN, *ADHESIVE, SERIES, WARM_ARM, *ELSEWHERE}
    assert [one for one in commands_of_the_table() if one not in run] == []
    assert [one for one in run if one not in commands_of_the_table()] == []
    for place in ELSEWHERE.values():
        path, name = place.split("::")
        assert re.search(rf"^def {name}\(", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE), place


def test_each_study_has_figures_to_compare_but_those_that_are_only_run() -> None:
    assert {name for name, trial in STUDIES.items() if not trial.figures} == ONLY_RUN


@pytest.mark.parametrize("command", [name for name, trial in STUDIES.items() if not trial.is_slow])
def test_a_command_gives_the_figures_of_its_row(command: str, tmp_path: Path) -> None:
    run_study(command, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(HANGS_S)
@pytest.mark.parametrize("command", [name for name, trial in STUDIES.items() if trial.is_slow])
def test_a_long_command_gives_the_figures_of_its_row(command: str, tmp_path: Path) -> None:
    run_study(command, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(HANGS_S)
@pytest.mark.parametrize("command", CASES)
def test_a_case_gives_the_figures_of_its_row(command: str, commands: Commands, tmp_path: Path) -> None:
    program, *words = shlex.split(command)
    done = commands.run(
        program, *words, *CASES[command].options, "--out", str(tmp_path / "runs"), timeout_s=HANGS_S
    )
    judge(CASES[command], done, tmp_path)


def run_study(command: str, folder: Path) -> None:
    """Run a study or another command without devices in its small size, and judge its figures."""
    program, *words = shlex.split(command)
    out = () if program == "ronna-sim" else ("--out", str(folder))
    app = import_module(COMMANDS[program]).app
    judge(STUDIES[command], in_this_process(app, *words, *STUDIES[command].options, *out), folder)


def judge(trial: Trial, done: subprocess.CompletedProcess[str], folder: Path) -> None:
    """Assert that a command has ended well, and written its files with these figures."""
    assert done.returncode == 0, done.stderr
    if any(figure.file == SHOWN for figure in trial.figures):
        is_json = done.stdout.lstrip().startswith("{")
        shown = json.loads(done.stdout) if is_json else tomllib.loads(done.stdout)
        (folder / SHOWN).write_text(json.dumps(shown), encoding="utf-8")
    assert [name for name in trial.writes if not (folder / name).is_file()] == []
    for figure in trial.figures:
        value = read_value(folder / figure.file, figure.address)
        assert figure.least <= value <= figure.most, f"{figure.address}: {value}"


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished case of the mini scene, to be read only."""
    out, printed = finished_mini(tmp_path_factory)
    return out / str(json.loads(printed)["run"])


@pytest.mark.timeout(HANGS_S)
@pytest.mark.parametrize("command", OF_A_RUN)
def test_a_command_about_a_run_prints_what_its_row_says(
    command: str, finished_run: Path, tmp_path: Path
) -> None:
    program, *words = command.split()
    named = [str(finished_run) if word == "RUN" else word for word in words]
    out = ("--out", str(tmp_path)) if "report" in words else ()
    done = in_this_process(import_module(COMMANDS[program]).app, *named, *out)
    assert done.returncode == 0, done.stderr
    assert re.search(OF_A_RUN[command], done.stdout + done.stderr)


@pytest.mark.timeout(HANGS_S)
def test_the_report_of_a_run_tells_the_pose_at_its_target_by_six_values(
    finished_run: Path, tmp_path: Path
) -> None:
    app = import_module(COMMANDS["ronna-procedure"]).app
    done = in_this_process(app, "report", str(finished_run), "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    file = tmp_path / "report" / "guide_poses.csv"
    assert read_value(file, "count::x_mm") == 1
    assert abs(read_value(file, "row:target=T1:beta_deg")) <= 90.0


@pytest.mark.slow
@pytest.mark.timeout(HANGS_S)
def test_an_arm_with_encoder_steps_that_grows_warm_reaches_the_target(
    commands: Commands, tmp_path: Path
) -> None:
    app = import_module(COMMANDS["ronna-sim"]).app
    scene = in_this_process(app, "scene", "--scene", "mini", "--seed", "1", "--markers", "5").stdout
    for key, value in WARM_VALUES.items():
        scene, times = re.subn(rf"^{key} = .*$", f"{key} = {value}", scene, flags=re.MULTILINE)
        assert times == 1, key
    (tmp_path / "scene.toml").write_text(scene, encoding="utf-8")
    program, *words = WARM_ARM.replace("FILE", str(tmp_path / "scene.toml")).split()
    done = commands.run(program, *words, "--json", "--out", str(tmp_path / "runs"), timeout_s=HANGS_S)
    shown = json.loads(done.stdout)
    assert shown["outcome"] in ("done", "in doubt")  # warmed between two looks at its guide
    assert shown["max_application_error_mm"] <= OCS_MM


@pytest.mark.slow
@pytest.mark.timeout(HANGS_S)
def test_adhesive_rings_of_a_phantom_are_found(tmp_path: Path) -> None:
    series = tmp_path / "phantom"
    for command in ADHESIVE:
        program, *words = command.split()
        named = [str(series) if word == "DIR" else word for word in words]
        done = in_this_process(import_module(COMMANDS[program]).app, *named)
        assert done.returncode == 0, done.stderr
        series = next((one.parent for one in tmp_path.rglob("*.dcm")), series)


@pytest.mark.slow
@pytest.mark.timeout(HANGS_S)
def test_spheres_inserted_into_a_series_are_found(tmp_path: Path) -> None:
    head, study = tmp_path / "head", tmp_path / "study"
    painted = in_this_process(import_module(COMMANDS["ronna-sim"]).app, "phantom", "--out", str(head))
    assert painted.returncode == 0, painted.stderr
    program, *words = SERIES.replace("DIR", str(head / "ct")).split()
    small = ("--volumes", "1", *SMALL, "--out", str(study))
    done = in_this_process(import_module(COMMANDS[program]).app, *words, *small)
    judge(Trial(figures=INSERTED), done, study)
