"""Table of every command, from their help."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Any

import typer
from reference_tables import table

from ronna_hw.command_line.launch import COMMANDS


def command_table() -> str:
    """Tabulate all commands with the first sentence of their help."""
    rows = [
        row
        for name, module in sorted(COMMANDS.items())
        for row in _list_commands(typer.main.get_command(import_module(module).app), name)
    ]
    return table(("command", "purpose"), rows)


def _list_commands(command: Any, path: str) -> Iterator[tuple[str, str]]:
    inner = getattr(command, "commands", {})
    if not inner:
        arguments = " ".join(
            (one.metavar or one.name.upper()) for one in command.params if one.param_type_name == "argument"
        )
        yield f"`{f'{path} {arguments}'.rstrip()}`", _first_sentence(command.help or "")
    for name, one in inner.items():
        yield from _list_commands(one, f"{path} {name}")


def _first_sentence(text: str) -> str:
    first = " ".join(text.partition("\n\n")[0].split())
    sentence = first.partition(". ")[0].rstrip(".")
    return sentence if sentence.endswith("?") else f"{sentence}."
