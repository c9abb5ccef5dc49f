"""Options common to several commands: logging, version, option records, output files.

Every command has `--verbose`, `--log-level` and `--version`; a group has only the last.
"""

from __future__ import annotations

import functools
import inspect
import logging
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import typer

from ronna_hw.arguments import require_path
from ronna_hw.command_line.errors import PATH_PROBLEM, UsageMistake, format_parameter
from ronna_hw.command_line.messages import say
from ronna_hw.errors import RonnaError
from ronna_hw.logs import LEVELS, Logger, is_known_logger, list_loggers, logger, set_level
from ronna_hw.near_names import did_you_mean

LEVELS_VARIABLE = "RONNA_LOG"
VERBOSE_FLAG = "--verbose"


def with_common_options(command: Any) -> Any:
    """Add the common options to a typer command, or to every command of a group, and return it."""
    declared = _create_options()
    for one in _walk_commands(command):
        for parameter in one.params:
            _refuse_empty_path(parameter)
        is_group = bool(getattr(one, "commands", {}))
        one.params.extend(declared[-1:] if is_group else declared)
    return command


def _refuse_empty_path(parameter: Any) -> None:
    """Make an option or argument for a path refuse an empty one, as an unset variable gives; ARG-001."""
    annotation = parameter.type_descriptor.annotation
    if Path not in (annotation, *get_args(annotation)):
        return
    process_value = parameter.process_value

    def process_filled(context: Any, value: Any) -> Any:
        for one in value if isinstance(value, list | tuple) else [value]:
            if isinstance(one, str):
                require_path(one, format_parameter(parameter).strip("[]"))
        return process_value(context, value)

    parameter.process_value = process_filled


def _walk_commands(command: Any) -> Iterator[Any]:
    """Yield a command and all its subcommands."""
    yield command
    for one in getattr(command, "commands", {}).values():
        yield from _walk_commands(one)


def _create_options() -> list[Any]:
    """Create the common options as typer would; callbacks handle them, so commands receive no value."""
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
        """Declare the options; never called."""

    return list(typer.main.get_command(app).params)


def _tell_version(wanted: bool) -> None:
    if not wanted:
        return
    from ronna_hw.software import identify_software

    say(str(identify_software()))
    raise typer.Exit


def set_up_logging(verbose: bool) -> None:
    """Show the log on standard error with `--verbose`; otherwise silence library warnings.

    Python would print those among the messages of the command.
    """
    if not verbose:
        logging.getLogger().addHandler(logging.NullHandler())
        warnings.simplefilter("ignore")
        return
    from ronna_hw.log_output import describe_computer, show_log

    show_log(sys.stderr)
    command_logger().info("started", **describe_computer())


def set_log_levels(levels: Sequence[str]) -> None:
    """Set log levels such as `debug` (every logger) or `tracker=debug` (one); raises CLI-001."""
    for entry in levels:
        name, _, level = entry.strip().rpartition("=")
        if name and not is_known_logger(name):
            raise UsageMistake(
                f"log level {entry!r}: nothing logs as {name!r}",
                expected=", ".join(list_loggers()),
                action=did_you_mean(name, list_loggers())
                or "Name one of them, as tracker=debug, or a level alone for all.",
            )
        try:
            set_level(level.lower(), name)
        except ValueError as wrong:
            raise UsageMistake(
                f"log level {entry!r}: {wrong}",
                action=did_you_mean(level, LEVELS)
                or "Give a level, as debug, or that of one logger, as tracker=debug.",
            ) from wrong


def set_log_levels_by_option(levels: Sequence[str] | None) -> None:
    """Set log levels for this process and any that it starts or execs; raises CLI-001."""
    if not levels:
        return
    set_log_levels(levels)
    before = os.environ.get(LEVELS_VARIABLE)
    os.environ[LEVELS_VARIABLE] = ",".join((*([before] if before else []), *levels))


def set_log_levels_from_environment() -> None:
    """Set log levels from the comma-separated RONNA_LOG; options are applied later and take precedence."""
    if given := os.environ.get(LEVELS_VARIABLE):
        set_log_levels(given.split(","))


def command_logger() -> Logger:
    """Return the logger of the current command."""
    return logger(command=Path(sys.argv[0]).name)


def log_failure(problem: Exception, error: RonnaError) -> None:
    """Log a failed command's error and where it was raised, omitting all values."""
    import traceback

    frames = traceback.extract_tb(problem.__traceback__)
    raised_at = [f"{Path(frame.filename).name}:{frame.lineno}" for frame in frames]
    command_logger().error("failed", error=error, raised_by=type(problem).__name__, trace=raised_at)


Returned = TypeVar("Returned")


def with_option_records(command: Callable[..., Returned]) -> Callable[..., Returned]:
    """Decorate a typer command, replacing each dataclass parameter with its fields.

    A field is declared like a parameter, `name: Annotated[type, typer.Option(...)] = default`. The command
    itself receives the record.
    """
    parameters = inspect.signature(command, eval_str=True).parameters
    records = {
        name: one.annotation
        for name, one in parameters.items()
        if isinstance(one.annotation, type) and is_dataclass(one.annotation)
    }

    def expand_parameters() -> Iterator[inspect.Parameter]:
        for name, one in parameters.items():
            if name not in records:
                yield one.replace(kind=inspect.Parameter.KEYWORD_ONLY)
                continue
            types = get_type_hints(records[name], include_extras=True)
            for field in fields(records[name]):
                yield inspect.Parameter(
                    field.name,
                    inspect.Parameter.KEYWORD_ONLY,
                    default=field.default,
                    annotation=types[field.name],
                )

    @functools.wraps(command)
    def call_with_records(**given: Any) -> Returned:
        for name, record in records.items():
            given[name] = record(**{field.name: given.pop(field.name) for field in fields(record)})
        return command(**given)

    # What `inspect.signature`, and so typer, reads first; the type of a function does not declare it.
    call_with_records.__signature__ = inspect.Signature(list(expand_parameters()))  # type: ignore[attr-defined]
    return call_with_records


def require_folder(out: Path) -> None:
    """Raise CLI-005 if `--out` is a file instead of a folder, or a new folder that cannot be made."""
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not there.is_dir():
        inside = "" if there == out else f", so {out} cannot be made"
        raise PATH_PROBLEM(f"--out: {there} is a file{inside}", expected="a folder, which may be new")
    if there != out:
        _require_disk(f"--out: {out}", there)


def _require_disk(what: str, there: Path) -> None:
    if not os.statvfs(there).f_blocks:  # such as /proc
        raise PATH_PROBLEM(
            f"{what} cannot be made: {there} is on no disk",
            expected="a place on a disk",
            action="Name another.",
        )


def require_output_folder(out: Path) -> None:
    """Raise CLI-005 for an output folder that is a file, belongs to a run, or holds runs."""
    from ronna_hw.evidence.journal_reading import JOURNAL_FILE

    require_folder(out)
    require_outside_runs(out)
    if out.is_dir() and any((one / JOURNAL_FILE).exists() for one in out.iterdir()):
        raise PATH_PROBLEM(
            f"{out} holds runs, which this would mix with other files",
            expected="a folder without runs, which may be new",
            action=f"Name another, such as {out / 'results'}.",
        )


def require_outside_runs(*outputs: Path) -> None:
    """Raise CLI-005 for an output that is a run's folder or inside one: it would break the run's evidence."""
    from ronna_hw.evidence.journal_reading import JOURNAL_FILE

    for out in outputs:
        place = out.resolve()
        for folder in (place, *place.parents):
            if (folder / JOURNAL_FILE).exists():
                raise PATH_PROBLEM(
                    f"{out} is {'the folder of a run' if folder == place else f'inside the run {folder}'}",
                    expected="a place outside every run, which may be new",
                    action=f"Name another, such as one in {folder.parent}: an addition breaks a run's seal.",
                )


def require_folder_of(*files: Path) -> None:
    """Raise CLI-005 for a file in a run or without a folder; call before the work that writes the file."""
    require_outside_runs(*files)
    for file in files:
        if not file.parent.is_dir():
            raise PATH_PROBLEM(
                f"{file.parent} is not a folder",
                expected=f"an existing folder for {file.name}",
                action="Create the folder, or name another.",
            )
        if not file.exists():
            _require_disk(str(file), file.parent)


def require_new(*files: Path) -> None:
    """Raise CLI-001 if a file exists, CLI-005 if its folder does not."""
    for file in files:
        if file.exists():
            raise UsageMistake(f"{file} exists and was not changed", action="Name a new file with --out.")
    require_folder_of(*files)
