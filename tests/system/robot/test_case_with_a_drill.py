"""A whole case in which the assistant drills and something fails: the drill is off, the arms at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from simulated_case import LIMIT_S, SimulatedCase

from procedures.journal.journal import Entry, Line
from ronna_hw.errors import EXIT_REFUSED, EXIT_SAFETY_STOP
from ronna_hw.roles import ASSISTANT
from ronna_hw.wire.room_tasks import DRILL, REST_DRILL, TEST_WEIGHT, TURN_DRILL
from sim.world.process import load_scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

CASE = ("--scene", "mini", "--seed", "1", "--dual", "--drill")
DRILLING_S = 50.0  # theatre time since the begin of the step, when the drill is in the skull


def first(lines: Sequence[Line], is_it: Callable[[Line], bool]) -> int:
    """The number of the first such line."""
    return next(number for number, line in enumerate(lines) if is_it(line))


def is_motion(line: Line) -> bool:
    return line["entry"] == Entry.MOTION


def is_insertion(line: Line) -> bool:
    return is_motion(line) and (line["arm"], line["what"]) == (ASSISTANT, "insert")


def feeds(case: SimulatedCase) -> list[tuple[object, object]]:
    """How each record of an opening has the end of its feed, and whether the force fell."""
    openings = [line["opening"] for line in case.journal if line.get("opening")]
    return [(one["end"], one["force_fell"]) for one in openings]  # type: ignore[index,call-overload]  # lines of JSON


@pytest.mark.hazard(66)
def test_where_no_bone_is_felt_the_step_ends_with_the_drill_off_and_the_arms_at_rest(
    case: SimulatedCase,
) -> None:
    ended = case.run(*CASE, faults="at 0 s: room bone thicker -6.8 mm")  # no bone at all
    assert ended.returncode == EXIT_REFUSED, ended.stdout
    assert "PRO-007: at T1 the drill felt no bone" in ended.stderr
    journal = case.journal
    off = first(journal, lambda line: line.get("task") == REST_DRILL)
    assert first(journal, lambda line: line.get("task") == TURN_DRILL) < off
    assert not any(map(is_motion, journal[off:]))
    assert not [line for line in journal if line["entry"] == Entry.CONFIRMATION and "drilled" in str(line)]
    held = [line["drill"] for line in journal if line["entry"] == Entry.HELD and line.get("drill")]
    assert held[-1]["may_turn"] is False  # type: ignore[index,call-overload]  # lines of JSON


@pytest.mark.hazard(66)
def test_a_force_sensor_that_shows_half_of_the_force_is_found_before_the_drill_is_in_the_holder(
    case: SimulatedCase,
) -> None:
    scene = load_scene("mini", seed=1, dual=True)
    assert scene.assistant is not None
    assert scene.assistant.force_sensor is not None
    sensor = scene.assistant.force_sensor.model_copy(update={"scale": 0.5})
    assistant = scene.assistant.model_copy(update={"force_sensor": sensor})
    ended = case.run("--dual", "--drill", scene=scene.model_copy(update={"assistant": assistant}))
    assert ended.returncode == EXIT_REFUSED, ended.stdout
    assert "PRO-007: at T1 the assistant's force sensor shows a weight of 19.6 N as" in ended.stderr
    weights = [line["subject"] for line in case.journal if line.get("task") == TEST_WEIGHT]
    assert [str(subject).split(" ")[0] for subject in weights] == ["hang", "take"]
    assert not [line for line in case.journal if line["entry"] == Entry.HELD]


@pytest.mark.hazard(65)
def test_after_an_emergency_stop_with_the_drill_turning_it_is_switched_off_led_out_and_asked_about(
    case: SimulatedCase,
) -> None:
    stop = f"since step == at_target after {DRILLING_S:g} s: assistant robot emergency stop for 5 s"
    ended = case.run(*CASE, faults=stop)
    assert ended.returncode == EXIT_REFUSED, ended.stdout
    stopped = case.journal
    assert first(stopped, lambda line: line.get("task") == TURN_DRILL) < first(
        stopped, lambda line: line["entry"] == Entry.FAILED
    )
    failed = first(stopped, lambda line: line["entry"] == Entry.FAILED)
    assert not any(map(is_motion, stopped[failed:]))
    folder = str(case.run_folder)
    shown = case.commands.run("ronna-procedure", "show", folder, timeout_s=LIMIT_S)
    assert "MAY BE TURNING" in shown.stdout
    done = case.commands.run("ronna-procedure", "resume", folder, "--accept", "--json", timeout_s=LIMIT_S)
    assert done.returncode == 0, done.stderr
    after = case.journal[len(stopped) :]
    off = first(after, lambda line: line.get("task") == REST_DRILL)
    out = first(after, is_motion)
    asked = first(after, lambda line: "DRILLING WAS BEGUN" in str(line.get("subject", "")))
    again = first(after, is_insertion)
    assert off < out < asked < again
    assert (after[out]["arm"], after[out]["what"]) == (ASSISTANT, "withdraw")


NOT_DRILLED = '[answers]\nbreakthrough = "no"\n'


@pytest.mark.hazard(65)
def test_after_a_breakthrough_that_was_not_accepted_no_repetition_leads_the_drill_in_again(
    case: SimulatedCase,
) -> None:
    ended = case.run(*CASE, faults="since step == at_target: room bone thicker -2.8 mm", answers=NOT_DRILLED)
    assert ended.returncode == EXIT_REFUSED, ended.stdout
    assert "the operator did not accept the opening at T1" in ended.stderr
    assert feeds(case) == [("not recorded", False), ("ended", True)]
    before = len(case.journal)
    folder = str(case.run_folder)
    again = case.commands.run("ronna-procedure", "resume", folder, "--accept", "--json", timeout_s=LIMIT_S)
    assert again.returncode == EXIT_REFUSED, again.stdout
    assert "an opening was through at" in again.stderr
    after = case.journal[before:]
    assert first(after, lambda line: is_motion(line) and line["what"] == "withdraw") >= 0
    assert not list(filter(is_insertion, after))


@pytest.mark.hazard(66)
def test_a_drill_that_is_pressed_aside_in_the_bone_stops_and_says_so(case: SimulatedCase) -> None:
    ended = case.run(*CASE, faults="at 0 s: room drill pushed aside 10 0 N")
    assert ended.returncode == EXIT_SAFETY_STOP, ended.stdout
    assert "ARM-015" in ended.stderr
    assert "a force across its axis pushes the drill" in ended.stderr
    failed = first(case.journal, lambda line: line["entry"] == Entry.FAILED)
    assert not any(map(is_motion, case.journal[failed:]))


@pytest.mark.hazard(65)
def test_where_a_force_across_hides_whether_bone_resists_the_drill_stops_and_a_hand_drills_on(
    case: SimulatedCase,
) -> None:
    thin = "since step == at_target: room bone thicker -2.8 mm\nat 0 s: room drill pushed aside 7 0 N"
    ended = case.run(*CASE, faults=thin)
    assert ended.returncode == EXIT_SAFETY_STOP, ended.stdout
    assert "ARM-015" in ended.stderr
    assert "hides whether bone resists" in ended.stderr
    assert feeds(case) == [("not recorded", False), ("interrupted", False)]
    before = len(case.journal)
    folder = str(case.run_folder)
    done = case.commands.run("ronna-procedure", "resume", folder, "--accept", "--json", timeout_s=LIMIT_S)
    assert done.returncode == 0, done.stderr
    after = case.journal[before:]
    assert TURN_DRILL not in {line.get("task") for line in after}
    assert DRILL in {line.get("task") for line in after}
    assert "a hand drills: drilling was begun there" in str(after)
