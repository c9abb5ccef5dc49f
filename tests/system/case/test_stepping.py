"""`ronna-procedure step --sim`: the case step by step."""

import json
import re
import signal
import subprocess
import tomllib
from pathlib import Path

import pytest
from run_folders import assert_nothing_half_written, await_motion_in, run_folder
from shared_by_workers import made_once
from simulated_case import SimulatedCase
from user_commands import Commands, in_this_process
from waiting import HANG_LIMIT_S

from procedures.cli.procedure import app as ronna_procedure
from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from procedures.runs.request_file import read_request
from ronna_hw.errors import EXIT_DONE, EXIT_RECOVERY_NEEDED

MOVING = "relocalization:T1"
MINI = ("--scene", "mini", "--seed", "3")


@pytest.fixture(scope="module")
def stepped(shared_commands: Commands, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str, Path]:
    """What a case said that was stepped with every option that only some cases have, and its folder.

    It is killed when its arm moves.
    """

    def step(out: Path) -> str:
        stepping = SimulatedCase(shared_commands, out)
        orders = ("list", "run to ct_import", "why positioning:T1", "run positioning:T1", f"to {MOVING}")
        process = stepping.start_stepping(
            *orders, words=(*MINI, "--calibrated", "--measure-targets", "--keep-raw")
        )
        await_motion_in(out / "runs", MOVING)
        process.kill()
        said = process.communicate(timeout=HANG_LIMIT_S)
        assert shared_commands.await_no_survivors() == []
        return json.dumps(said)

    out, said = made_once(tmp_path_factory, "stepped", step)
    return (*json.loads(said), run_folder(out / "runs"))


def test_steps_can_be_listed_run_and_refused_with_reasons(stepped: tuple[str, str, Path]) -> None:
    said, errors, _ = stepped
    assert "next  ct_import" in said
    assert "done ct_import (Import the CT series): " in said
    assert "positioning:T1: refused: fiducial_localization comes first" in said
    assert "PRO-001" in errors


@pytest.mark.hazard(2)
def test_killing_the_command_leaves_no_process_and_no_torn_record(stepped: tuple[str, str, Path]) -> None:
    _, _, run = stepped
    assert_nothing_half_written(run.parent)


def test_a_stepped_case_has_every_option_of_a_case(stepped: tuple[str, str, Path]) -> None:
    said, _, run = stepped
    assert "target_measurement:T1" in said
    asked = read_request(run)
    assert asked.case.keep_raw
    assert "arm" in tomllib.loads((run / "theatre" / "theatre.toml").read_text())["calibration"]


@pytest.mark.slow
def test_a_case_begun_by_step_is_resumed_by_step(case: SimulatedCase) -> None:
    case.step("to set_up", "quit", words=MINI)
    line = ("ronna-procedure", "resume", str(case.run_folder), "--accept")
    resumed = case.commands.start(*line, stdin=subprocess.PIPE)
    said, errors = resumed.communicate("next\nquit\n", timeout=HANG_LIMIT_S)
    assert resumed.returncode == EXIT_DONE, errors
    assert "begun by step, and goes on by commands: next runs head_clamp, to confirmation:T1 runs all" in said
    assert [one for one in said.splitlines() if one.startswith("done ")] == [
        "done head_clamp (Clamp the head): 3 spheres seen, 3 implanted"
    ]


@pytest.mark.slow
def test_a_declined_approach_holds_the_case_which_can_then_be_aborted(case: SimulatedCase) -> None:
    no = '[answers]\n"approach:T1" = "no"'
    done = case.step("to positioning:T1", "abort", words=MINI, answers=no)
    assert done.returncode == 7, done.stderr
    assert "PRO-002" in done.stderr
    assert "the case is held" in done.stdout
    followed = in_this_process(ronna_procedure, "watch", case.run_folder, "--json")
    assert followed.returncode == 0
    kinds = [json.loads(line)["what"] for line in followed.stdout.splitlines()]
    assert [what["state"] for what in kinds if what["kind"] == "case"] == ["aborted"]


@pytest.mark.slow
@pytest.mark.hazard(2)
def test_commands_that_end_with_an_instrument_inside_end_with_an_error_that_says_how_to_go_on(
    case: SimulatedCase,
) -> None:
    hold = '[answers]\n"skin:T1" = "hold the guide"'
    done = case.step("to at_target:T1", "quit", words=MINI, answers=hold)
    assert done.returncode == EXIT_RECOVERY_NEEDED, done.stderr
    assert "home asks whether it is out, then drives home" in done.stdout
    run = case.run_folder
    assert "PRO-055: the commands have ended, and an instrument is still in T1" in done.stderr
    assert f"ronna-procedure home {run} asks for the removal" in done.stderr
    *_, closed = read_journal(run / JOURNAL_FILE)
    assert (closed["outcome"], closed["instrument_in"]) == ("left", "T1")
    assert in_this_process(ronna_procedure, "home", run, "--accept").returncode == EXIT_DONE


@pytest.mark.slow
@pytest.mark.hazard(1)
def test_a_plan_changed_during_a_case_stops_all_motion_and_voids_the_registration(
    case: SimulatedCase,
) -> None:
    process = case.start_stepping("to registration:T1", words=MINI)
    assert process.stdout is not None
    assert any(line.startswith("done registration:T1") for line in process.stdout)
    plan = case.run_folder / "case" / "plan.toml"
    plan.write_text(re.sub(r"(target_mm = \[\s*-?\d+\.)", r"\g<1>9", plan.read_text(), count=1))
    _, errors = process.communicate("next\nquit\n", timeout=60)
    assert "PRO-021" in errors
    lines = case.journal
    (voided,) = [line for line in lines if line["entry"] == Entry.VOIDED]
    assert all(line["entry"] != Entry.MOTION for line in lines[lines.index(voided) :])
    assert any("registration-T1" in str(name) for name in voided["supersedes"])


@pytest.mark.slow
@pytest.mark.hazard(32)
def test_a_script_stops_the_arm_during_a_step_and_decides_how_it_goes_on(
    case: SimulatedCase,
) -> None:
    process = case.start_stepping(f"to {MOVING}", words=MINI)
    await_motion_in(case.folder / "runs", MOVING)
    said, errors = process.communicate("stop\nresume\nquit\n", timeout=100)
    assert process.returncode == 0, errors
    assert "Paused: a stop was ordered on the standard input; " in said
    assert "done relocalization:T1" in said
    lines = case.journal
    rested = next(number for number, line in enumerate(lines) if line["entry"] == Entry.RESTED)
    assert any(line["entry"] == Entry.MOTION for line in lines[:rested])
    assert any(line["entry"] == Entry.MOTION for line in lines[rested:])


@pytest.mark.slow
def test_a_signal_at_the_prompt_after_the_last_step_ends_a_finished_case(
    case: SimulatedCase,
) -> None:
    process = case.start_stepping("to confirmation:T1", words=MINI)
    assert process.stdout is not None
    assert any(line.startswith("done confirmation:T1") for line in process.stdout)
    process.send_signal(signal.SIGTERM)
    said, errors = process.communicate(timeout=HANG_LIMIT_S)
    assert process.returncode == 0, errors
    assert "\nmean " in said  # of the errors at the targets, below their table
    shown = in_this_process(ronna_procedure, "show", case.run_folder, "--json")
    assert json.loads(shown.stdout)["ended"] == "done"
