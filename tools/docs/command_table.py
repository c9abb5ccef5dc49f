"""Table of every command, from their help."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from importlib import import_module
from typing import Any, Literal, get_args, get_origin

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


def option_table(command: str, name: str) -> str:
    """Tabulate the options of one of a program's commands."""
    found: Any = typer.main.get_command(import_module(COMMANDS[command]).app)
    options = [one for one in found.commands[name].params if not one.hidden]
    return table(
        ("option", "default", "meaning"),
        [
            (f"`{' '.join([one.opts[-1], _value_of(one)]).rstrip()}`", _default(one), one.help)
            for one in options
        ],
    )


def _value_of(option: Any) -> str:
    kind = option.type_descriptor.annotation
    if isinstance(kind, type) and issubclass(kind, Enum):
        return " or ".join(map(str, kind))
    if get_origin(kind) is Literal:
        return " or ".join(get_args(kind))
    return "" if option.is_flag else option.metavar or option.name.upper()


def _default(option: Any) -> str:
    return str(option.default) if option.default and option.default is not True else ""


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
