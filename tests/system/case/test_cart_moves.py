"""A cart that is not locked, and one that moves: scripted and live, each with its promised outcome."""

from __future__ import annotations

import json
import re

import pytest
from pydicom import dcmread
from report_figures import figures_in, figures_of_records
from simulated_case import SimulatedCase

from procedures.exchange.run_export import export_run
from procedures.journal.journal import Line
from procedures.steps.branches import GO_ON
from ronna_hw.control_port import ask_control_port
from ronna_hw.errors import EXIT_REFUSED

pytestmark = [pytest.mark.slow, pytest.mark.timeout(500)]
MINI = ("--scene", "mini", "--seed", "3", "--targets", "2")
CONTROL = re.compile(r"control port (\S+)")
ROLLS = "room unlocked cart 4 -3 0 mm per min"
MOVES = "room shift cart 1.5 2 0 mm"
WHEELED = "room move cart 1 60 -40 0 mm 6 deg in 0.2 s"
LARGEST_ERROR_MM = 0.6
KEPT = {"ct_import", "fiducial_localization", "plan_check", "set_up", "head_clamp"}


def done(lines: list[Line]) -> list[str]:
    return [line["step"] for line in lines if line["entry"] == "result"]


@pytest.mark.hazard(49)
@pytest.mark.branch("CART_UNLOCKED")
def test_a_case_with_an_unlocked_cart_ends_before_anything_is_localized(case: SimulatedCase) -> None:
    ran = case.run(*MINI, faults=f"at 0 s: {ROLLS}")
    assert ran.returncode == EXIT_REFUSED
    assert "PRO-041" in ran.stderr
    assert set(done(case.journal)) == KEPT


@pytest.mark.hazard(49)
@pytest.mark.branch("CART_UNLOCKED")
def test_opened_brakes_are_detected_and_once_they_are_closed_the_step_succeeds(case: SimulatedCase) -> None:
    stepping = case.start_stepping("to head_clamp", words=MINI)
    assert stepping.stdin is not None
    assert stepping.stdout is not None
    assert stepping.stderr is not None
    control = next(found for line in stepping.stderr if (found := CONTROL.search(line)))[1]
    assert any(line.startswith("done head_clamp") for line in stepping.stdout)
    ask_control_port(control, "fault", line=ROLLS)
    stepping.stdin.write("run cart_lock\n")
    stepping.stdin.flush()
    assert any("PRO-041" in line for line in stepping.stderr)
    ask_control_port(control, "clear_faults")
    stepping.communicate("run cart_lock\nquit\n", timeout=100)
    assert done(case.journal)[-1] == "cart_lock"


@pytest.mark.hazard(50)
@pytest.mark.branch("CART_MOVED")
@pytest.mark.parametrize(
    ("step", "again", "resumed"),
    [
        ("cart_lock", 0, False),  # before the localization: it is where it is
        ("relocalization:T2", 1, False),
        ("at_target:T2", 1, True),  # held as a pushed guide is, until the arm is home
    ],
)
def test_after_a_cart_move_the_case_continues_from_the_lock_and_reaches_its_targets(
    case: SimulatedCase, step: str, again: int, resumed: bool
) -> None:
    ran = case.run(*MINI, faults=f"since step == {step}: {MOVES}")
    if resumed:
        assert ran.returncode == EXIT_REFUSED, ran.stderr
        again_line = ("resume", str(case.run_folder), "--accept", "--json")
        ran = case.commands.run("ronna-procedure", *again_line, timeout_s=400)
    assert ran.returncode == 0, ran.stderr
    outcome = json.loads(ran.stdout)
    assert [target["id"] for target in outcome["targets"]] == ["T1", "T2"]
    assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
    lines = case.journal
    asked = [line for line in lines if line.get("topic") == "cart_moved"]
    assert [line["answer"] for line in asked] == [GO_ON] * (again and not resumed)
    steps = done(lines)
    assert steps.count("cart_lock") == steps.count("global_localization") == 1 + again
    assert all(steps.count(name) == 1 for name in (*KEPT, "at_target:T1", "retreat:T1"))
    voided = [line for line in lines if line["entry"] == "voided"]
    moved = [line for line in voided if line["step"] == "cart_lock"]
    assert len(moved) == again
    for line in moved:  # exactly what stood, without what does not depend on the cart, and finished targets
        before = lines[: lines.index(line)]
        stood = [one["record"] for one in before if one["entry"] == "result"]
        finished = "retreat:T1" in done(before)
        gone = {one for earlier in before if earlier["entry"] == "voided" for one in earlier["supersedes"]}
        kept = [one for one in stood if one[3:] in KEPT or (finished and one.endswith("-T1")) or one in gone]
        assert line["supersedes"] == [one for one in stood if one not in kept]
    run = case.run_folder
    assert figures_in(run / "report.html") == figures_of_records(run)
    registrations = [one for one in export_run(run, case.folder / "out").files if one.match("reg*.dcm")]
    frames = {dcmread(one).FrameOfReferenceUID for one in registrations}
    assert len(frames) == (2 if step == "at_target:T2" else 1)  # before and after a move: two


@pytest.mark.hazard(13)
@pytest.mark.hazard(50)
@pytest.mark.branch("CART_MOVED")
@pytest.mark.parametrize(
    "moment",
    ["positioning:T2 after 2.2 s", "relocalization:T1 after 9 s"],
    ids=["during a motion", "in a look"],
)
def test_after_a_cart_was_wheeled_away_the_case_registers_again_and_reaches_its_targets(
    case: SimulatedCase, moment: str
) -> None:
    ran = case.run(*MINI, faults=f"since step == {moment}: {WHEELED}")
    assert ran.returncode == 0, ran.stderr
    outcome = json.loads(ran.stdout)
    assert [target["id"] for target in outcome["targets"]] == ["T1", "T2"]
    assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
    failed = [line for line in case.journal if line["entry"] == "failed"]
    assert [(line["step"], line["code"]) for line in failed] == [(moment.split()[0], "PRO-019")]


@pytest.mark.hazard(13)
def test_a_cart_wheeled_away_with_an_instrument_inside_leaves_the_arm_where_it_is(
    case: SimulatedCase,
) -> None:
    ran = case.run(*MINI, faults=f"since step == at_target:T2 after 2.2 s: {WHEELED}")
    assert ran.returncode == EXIT_REFUSED
    assert "PRO-019" in ran.stderr
    lines = case.journal
    inside = [number for number, line in enumerate(lines) if line.get("inside")][-1]
    assert "motion" not in {line["entry"] for line in lines[inside:]}
    assert "cart_moved" not in {line.get("topic") for line in lines}
    assert any("T2 in doubt" in line["text"] for line in lines if line["entry"] == "finding")


@pytest.mark.hazard(50)
@pytest.mark.branch("CART_MOVED")
def test_without_consent_the_case_stops_and_the_cart_is_not_locked_again(case: SimulatedCase) -> None:
    held = 'default = "first"\n[answers]\ncart_moved = "hold"'
    ran = case.run(*MINI, faults=f"since step == relocalization:T2: {MOVES}", answers=held)
    assert ran.returncode == EXIT_REFUSED
    assert "PRO-019" in ran.stderr
    lines = case.journal
    assert [line["entry"] for line in lines].count("voided") == 1
    assert done(lines).count("cart_lock") == 1
