"""The questions of a coming step are shown before it; every clinical test checks that it asks no others."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from clinical_case import ClinicalCell

from procedures.cli.case.commands import carry_out, read_command
from procedures.operator.question import Topic
from procedures.steps import branches
from procedures.steps.branches import BRANCHES, Branch, BranchEnding
from procedures.steps.catalogue import CLINICAL_STEPS, list_questions, name_every_step


def said(tmp_path: Path, command: str, argument: str = "") -> list[str]:
    lines: list[str] = []
    engine = ClinicalCell(tmp_path).begin(*CLINICAL_STEPS)
    carry_out(engine, read_command(engine, command, argument), lines.append)
    return lines


@pytest.mark.hazard(36)
@pytest.mark.parametrize("command", ["why", "dry"])
def test_the_questions_of_a_step_are_shown_with_their_answers(tmp_path: Path, command: str) -> None:
    lines = said(tmp_path, command, "positioning:T1")
    assert "  asks approach: yes or no" in lines
    assert any(line.startswith("  asks head_unseen: wait, continue or leave, if a guide") for line in lines)
    assert any(line.startswith("  asks first_motion: yes or no, if the arm has not moved") for line in lines)


def test_the_list_of_steps_names_what_each_asks_in_its_course(tmp_path: Path) -> None:
    (line,) = [line for line in said(tmp_path, "list") if "at_target:T1" in line]
    assert line.endswith("; asks depth_stop, skin, drill, dura, at_target, instrument_out")


def test_a_question_of_the_course_and_of_a_branch_is_planned_once() -> None:
    for step in CLINICAL_STEPS:
        planned = [one.topic for one in list_questions(step) if not one.condition]
        assert planned == list(step.asks)
    (gauge,) = [step for step in CLINICAL_STEPS if step.name == "tool_check"]
    assert [one.topic for one in list_questions(gauge)].count(Topic.INSTRUMENT_OUT) == 1


TESTS = Path(__file__).resolve().parents[2]
ROWS = {name: row for name, row in vars(branches).items() if isinstance(row, Branch)}


def test_every_row_is_covered_by_a_test() -> None:
    reached: set[str] = set()
    for path in TESTS.rglob("test_*.py"):
        reached |= set(re.findall(r'mark\.branch\("(\w+)"\)', path.read_text(encoding="utf-8")))
    assert reached == set(ROWS)


@pytest.mark.parametrize("row", BRANCHES, ids=ROWS)
def test_a_row_names_steps_of_a_case_and_a_question_only_if_it_asks_whose_silence_never_continues(
    row: Branch,
) -> None:
    assert set(row.steps) <= name_every_step().keys()
    assert (row.ending is BranchEnding.ASK) == isinstance(row.topic, Topic) == bool(row.answers)
    assert not row.answers or row.answers[-1] != row.answers[0]
