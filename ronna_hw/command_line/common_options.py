"""Options that every command has: `--version` beside `--help`, and `--verbose` also where there is no log."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import typer

from ronna_hw.command_line.logging_options import VERBOSE_FLAG, set_up_logging
from ronna_hw.command_line.messages import say

VERSION_FLAG = "--version"


def with_common_options(command: Any) -> Any:
    """Add them to typer's command and to all commands of a group; returns it."""
    version, verbose = _declared()
    for one in _all(command):
        is_group = bool(getattr(one, "commands", {}))
        if not is_group and not any(VERBOSE_FLAG in option.opts for option in one.params):
            one.params.append(verbose)
        one.params.append(version)
    return command


def _all(command: Any) -> Iterator[Any]:
    """A command and all below it."""
    yield command
    for one in getattr(command, "commands", {}).values():
        yield from _all(one)


def _tell_version(wanted: bool) -> None:
    if not wanted:
        return
    from ronna_hw.software import this_software

    say(str(this_software()))
    raise typer.Exit


def _show_log(wanted: bool) -> None:
    if wanted:
        set_up_logging(wanted)


def _declared() -> list[Any]:
    """The options as typer makes them: `--version`, `--verbose`."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None)

    @app.command()
    def declare(
        version: Annotated[
            bool,
            typer.Option(
                VERSION_FLAG,
                is_eager=True,
                expose_value=False,
                callback=_tell_version,
                help="Show version, commit and lock of the packages, and exit.",
            ),
        ] = False,
        verbose: Annotated[
            bool,
            typer.Option(
                VERBOSE_FLAG,
                expose_value=False,
                callback=_show_log,
                help="Show the log on standard error and, on an error, its traceback.",
            ),
        ] = False,
    ) -> None:
        """Never called: it declares two options."""

    return list(typer.main.get_command(app).params)
