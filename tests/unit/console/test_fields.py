"""What a person types into the planner's number fields: taken, refused in words, or put back."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest
from nicegui import Client, ui
from plan_editors import draw, scan

from console.guard import Role, Session
from console.planning.fields import NumberField
from console.planning.page import PlannerPage
from console.planning.plan_editor import PlanEditor
from ronna_hw.text.typed_number import typed_number


@pytest.mark.parametrize(
    ("words", "number"),
    [("-12.5", -12.5), ("8,4", 8.4), (" +3 ", 3.0), ("−7", -7.0), (".5", 0.5), ("12.", 12.0)],
)
def test_typed_numbers_are_read_with_comma_sign_and_blanks(words: str, number: float) -> None:
    assert typed_number(words) == typed_number(f"{words} MM", "mm") == number


NONE = ["1,2,3", "1 2", "1e9", "nan", "inf", "twelve", "--1", "1.000,5", "1_000", "9" * 400]


@pytest.mark.parametrize("words", ["", *NONE])
def test_text_that_is_not_a_number_is_refused(words: str) -> None:
    with pytest.raises(ValueError, match=f"^'{words}'$"):
        typed_number(words)


def typed(field: NumberField, words: str) -> str:
    """Type into a field and leave it; returns what it complains of."""
    field._field.set_value(words)
    field._typed()
    return str(field._field.props.get("error-message", ""))


def on_a_page(do: Callable[[], None]) -> None:
    async def page() -> None:
        with Client(ui.page("/of-a-test"), request=None):
            do()

    asyncio.run(page())


@pytest.mark.parametrize("words", NONE)
def test_a_field_says_with_an_example_that_its_text_is_not_a_number(words: str) -> None:
    taken: list[float] = []

    def do() -> None:
        assert "such as -12.5" in typed(NumberField("depth", "depth", taken.append), words)

    on_a_page(do)
    assert taken == []


def test_an_emptied_field_shows_its_number_again() -> None:
    taken: list[float] = []

    def do() -> None:
        field = NumberField("length", "length", taken.append)
        field.show(190.0)
        assert typed(field, "") == ""
        assert field._field.value == "190.0"
        assert "such as" in typed(field, "19o")
        assert field.is_wrong
        assert typed(field, " ") == ""
        assert (field._field.value, field.is_wrong) == ("190.0", False)

    on_a_page(do)
    assert taken == []


def test_a_fraction_of_a_sphere_is_refused() -> None:
    taken: list[float] = []

    def do() -> None:
        field = NumberField("spheres", "spheres", taken.append, 0)
        assert typed(field, "4.5") == "expected a whole number, got 4.5"
        assert typed(field, "5") == ""

    on_a_page(do)
    assert taken == [5.0]


def test_a_plan_is_not_saved_while_a_field_shows_something_else_than_its_value(tmp_path: Path) -> None:
    file = tmp_path / "plan.toml"
    editor = PlanEditor(scan(), file, None)
    draw(editor)

    async def saved() -> tuple[str, bool]:
        with Client(ui.page("/of-a-test"), request=None):
            page = PlannerPage(editor, Session(Role.OPERATOR, "session-1"), low=True)
            page.build()
            page._author.set_value("Dr Test")
            typed(page._ways.fields["target L"], "12o.5")
            await page._save_plan()
            refused, existed = str(page._words.content), file.exists()
            typed(page._ways.fields["target L"], "")
            await page._save_plan()
        return refused, existed

    refused, existed = asyncio.run(saved())
    assert "PLAN-002: target L is not as it was typed" in refused
    assert not existed
    assert file.exists()
