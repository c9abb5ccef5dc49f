"""Buttons of the operator and number fields of the planner."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from case_events import question
from nicegui import context, ui
from plan_editors import draw, scan
from shown_page import on_a_page

from console.guard import Session, SessionRole
from console.panels.orders import ARMED_S, HeldButton, OrderPanel, QuestionPanel
from console.planning.fields import NumberField
from console.planning.page import PlannerPage
from console.planning.plan_editor import PlanEditor
from procedures.engine.case_view import CaseView
from procedures.engine.events import Waiting
from ronna_hw.text import parse_typed_number


async def give(_order: dict[str, Any]) -> str:
    return ""


def test_the_next_button_is_replaced_when_the_upcoming_step_changes() -> None:
    def do() -> None:
        panel = OrderPanel(give, print)
        panel.show(CaseView(waiting=Waiting(upcoming="image")), is_mine=True)
        seen = panel._next
        panel.show(CaseView(waiting=Waiting(upcoming="fit:T1")), is_mine=True)
        assert (seen.is_deleted, panel._next.text) == (True, "Next: fit:T1")

    on_a_page(do)


@pytest.mark.parametrize(("topic", "possible"), [("pause", True), ("park", False)])
def test_faults_can_be_acknowledged_at_a_pause(topic: str, possible: bool) -> None:
    def enabled() -> bool:
        panel = OrderPanel(give, print)
        panel.show(CaseView(question=question(topic=topic)), is_mine=True)
        return panel._acknowledge.enabled

    assert on_a_page(enabled) is possible


@pytest.mark.parametrize(
    ("up", "acted"),
    [({"timeStamp": 1009.0}, 0), ({"timeStamp": 1011.0}, 1), ({}, 0), ({"timeStamp": "x"}, 0)],
)
def test_a_hold_button_acts_only_after_the_browser_reports_a_hold_of_one_second(
    up: dict[str, Any], acted: int
) -> None:
    done, said = [], []

    async def act() -> None:
        done.append(True)

    async def hold() -> None:
        button = HeldButton("yes", act, said.append)
        button._down(SimpleNamespace(args={"timeStamp": 10.0}))
        await button._up(SimpleNamespace(args={"timeStamp": 5000.0}))  # it has only just appeared
        button._appeared_s -= ARMED_S
        button._down(SimpleNamespace(args={"timeStamp": 10.0}))
        await button._up(SimpleNamespace(args=up))

    on_a_page(hold)
    assert (len(done), len(said)) == (acted, 1 - acted)


@pytest.mark.parametrize(
    ("topic", "answers", "shown"),
    [
        ("head_unseen", ("wait", "continue", "leave"), ["wait (press 1 s)", "continue (press 1 s)", "leave"]),
        ("pause", ("continue", "abort"), ["continue (press 1 s)", "abort (press 1 s)"]),
    ],
)
def test_of_a_deliberate_question_all_but_a_harmless_last_answer_are_held(
    topic: str, answers: tuple[str, ...], shown: list[str]
) -> None:
    view = CaseView(question=question(topic=topic, answers=answers, deliberate=True))

    def labels() -> list[str]:
        QuestionPanel(give, print).show(view, is_mine=True, has_seat=True)
        return [one.text for one in context.client.elements.values() if isinstance(one, ui.button)]

    assert on_a_page(labels) == shown


@pytest.mark.parametrize(
    ("words", "number"),
    [("-12.5", -12.5), ("8,4", 8.4), (" +3 ", 3.0), ("−7", -7.0), (".5", 0.5), ("12.", 12.0)],
)
def test_typed_numbers_are_read_with_comma_sign_and_blanks(words: str, number: float) -> None:
    assert parse_typed_number(words) == parse_typed_number(f"{words} MM", "mm") == number


NONE = ["1,2,3", "1 2", "1e9", "nan", "inf", "twelve", "--1", "1.000,5", "1_000", "9" * 400]


@pytest.mark.parametrize("words", ["", *NONE])
def test_text_that_is_not_a_number_is_refused(words: str) -> None:
    with pytest.raises(ValueError, match=f"^'{words}'$"):
        parse_typed_number(words)


def typed(field: NumberField, words: str) -> str:
    """Type into a field and leave it; returns what it complains of."""
    field._field.set_value(words)
    field._commit()
    return str(field._field.props.get("error-message", ""))


@pytest.mark.parametrize("words", NONE)
def test_a_field_says_with_an_example_that_its_text_is_not_a_number(words: str) -> None:
    def do() -> None:
        taken: list[float] = []
        assert "such as -12.5" in typed(NumberField("depth", "depth", taken.append), words)
        assert taken == []

    on_a_page(do)


def test_an_emptied_field_shows_its_number_again() -> None:
    def do() -> None:
        taken: list[float] = []
        field = NumberField("length", "length", taken.append)
        field.show(190.0)
        assert typed(field, "") == ""
        assert field._field.value == "190.0"
        assert "such as" in typed(field, "19o")
        assert field.is_wrong
        assert typed(field, " ") == ""
        assert (field._field.value, field.is_wrong) == ("190.0", False)
        assert taken == []

    on_a_page(do)


def test_a_fraction_of_a_sphere_is_refused() -> None:
    def do() -> None:
        taken: list[float] = []
        field = NumberField("spheres", "spheres", taken.append, 0)
        assert typed(field, "4.5") == "expected a whole number, got 4.5"
        assert typed(field, "5") == ""
        assert taken == [5.0]

    on_a_page(do)


def test_a_plan_is_not_saved_while_a_field_shows_something_else_than_its_value(tmp_path: Path) -> None:
    file = tmp_path / "plan.toml"
    editor = PlanEditor(scan(), file, None)
    draw(editor)

    async def do() -> None:
        page = PlannerPage(editor, Session(SessionRole.OPERATOR, "session-1"), low=True)
        page.build()
        page._author.set_value("Dr Test")
        typed(page._ways.fields["target L"], "12o.5")
        await page._save_plan()
        assert "PLAN-002: target L is not as it was typed" in str(page._words.content)
        assert not file.exists()
        typed(page._ways.fields["target L"], "")
        await page._save_plan()
        assert file.exists()

    on_a_page(do)
