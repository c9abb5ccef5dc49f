"""Options that every command has: `--verbose`, `--log-level`, `--version`; a group has only the last."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import typer

from ronna_hw.command_line.logging_options import VERBOSE_FLAG, set_log_levels_by_option, set_up_logging
from ronna_hw.command_line.messages import say


def with_common_options(command: Any) -> Any:
    """Add them to typer's command and to all commands of a group; returns it."""
    declared = _declared()
    for one in _all(command):
        is_group = bool(getattr(one, "commands", {}))
        one.params.extend(declared[-1:] if is_group else declared)
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


def _declared() -> list[Any]:
    """The options as created by typer: their callbacks do the work, and commands receive no value."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None)

    @app.command()
    def declare(
        verbose: Annotated[
            bool,
            typer.Option(
                VERBOSE_FLAG,
                expose_value=False,
                callback=set_up_logging,
                help="Show the log on standard error and, on an error, its traceback.",
            ),
        ] = False,
        log_level: Annotated[
            list[str] | None,
            typer.Option(
                "--log-level",
                metavar="[NAME=]LEVEL",
                is_eager=True,  # before the first line that --verbose shows
                expose_value=False,
                callback=set_log_levels_by_option,
                help="Level of the log, or of one logger such as tracker=debug; repeatable; also in "
                "RONNA_LOG.",
            ),
        ] = None,
        version: Annotated[
            bool,
            typer.Option(
                "--version",
                is_eager=True,
                expose_value=False,
                callback=_tell_version,
                help="Show version, commit and lock of the packages, and exit.",
            ),
        ] = False,
    ) -> None:
        """Never called: it declares the options."""

    return list(typer.main.get_command(app).params)
