"""Options declared once, as the fields of a dataclass."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
import typer
from user_commands import in_this_process

from ronna_hw.command_line.options import with_option_records


@dataclass(frozen=True)
class Place:
    """Where."""

    out: Annotated[Path, typer.Option(help="Where to write.")] = Path("here")


@dataclass(frozen=True)
class Drawing(Place):
    """Where, and what."""

    seeds: Annotated[list[int] | None, typer.Option("--seed", min=0, help="Seeds; repeatable.")] = None


app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
@with_option_records
def draw(
    name: Annotated[str, typer.Argument(help="Whom.")],
    *,
    drawing: Drawing,
    loud: Annotated[bool, typer.Option("--loud", help="Loudly.")] = False,
) -> None:
    """Draw it."""
    print(name, drawing, loud)


@pytest.mark.parametrize(
    ("arguments", "got"),
    [
        (("it",), ("it", Drawing(), False)),
        (
            ("it", "--seed", "3", "--loud", "--seed", "4", "--out", "there"),
            ("it", Drawing(Path("there"), [3, 4]), True),
        ),
    ],
)
def test_a_command_receives_its_options_as_a_record(
    arguments: tuple[str, ...], got: tuple[str, Drawing, bool]
) -> None:
    done = in_this_process(app, *arguments)
    assert done.stdout == f"{got[0]} {got[1]} {got[2]}\n", done.stderr


def test_help_lists_the_fields_at_the_position_of_the_record() -> None:
    shown = in_this_process(app, "--help").stdout
    assert shown.index("--out") < shown.index("Seeds; repeatable.") < shown.index("--loud")


def test_a_field_is_validated_like_any_option() -> None:
    done = in_this_process(app, "it", "--seed", "-1")
    assert done.returncode == 2
    assert "at least 0" in done.stderr
