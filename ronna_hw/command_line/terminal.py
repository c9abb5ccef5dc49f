"""Command execution: options, exit code, termination. Re-exports all shared command helpers.

Data goes to standard output, messages to standard error. A traceback is shown only with `--verbose`. The
first SIGINT or SIGTERM unwinds the command through its `finally` blocks and ends it with exit code 130.
"""

from __future__ import annotations

import contextlib
import copy
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Annotated, Any, NoReturn, TextIO

import typer

from ronna_hw.command_line.errors import (
    UsageMistake,
    as_ronna_error,
    convert_usage_error,
    find_selected_command,
)
from ronna_hw.command_line.messages import (
    Progress,
    fail_with,
    message_console,
    on_terminal,
    print_table,
    progress_bar,
    say,
    takes_escapes,
    tell,
)
from ronna_hw.command_line.options import (
    VERBOSE_FLAG,
    command_logger,
    log_failure,
    set_log_levels_from_environment,
    with_common_options,
)
from ronna_hw.errors import EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED, EXIT_USAGE
from ronna_hw.host.files import restrict_new_files
from ronna_hw.host.own_packages import require_own_packages
from ronna_hw.host.process import ENDING_SIGNALS, limit_to_one_thread

__all__ = [
    "JsonOption",
    "Progress",
    "command_group",
    "command_logger",
    "exit_code_of",
    "fail_with",
    "message_console",
    "on_terminal",
    "print_json",
    "print_table",
    "progress_bar",
    "run",
    "say",
    "takes_escapes",
    "tell",
]

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")]

# the base of typer's usage errors: unknown option, missing argument, bad value
_USAGE_ERROR: type[Exception] = typer.BadParameter.__bases__[0]
# one of them: no arguments at all; its message is the help
_NO_ARGUMENTS: type[Exception] = sys.modules[_USAGE_ERROR.__module__].NoArgsIsHelpError


def command_group(name: str, help: str, *, example: str = "") -> typer.Typer:
    """Return an application of several commands. Called without one, it shows its help."""
    epilog = f"Example: {example}" if example else None
    return typer.Typer(
        name=name, help=help, epilog=epilog, no_args_is_help=True, add_completion=False, rich_markup_mode=None
    )


def run(app: typer.Typer) -> NoReturn:
    """Run a command with this process's arguments and exit with the documented code."""
    limit_to_one_thread()
    code = exit_code_of(app, sys.argv[1:])
    for number in (signal.SIGINT, signal.SIGTERM):  # the outcome is final; only the interpreter has to exit
        signal.signal(number, signal.SIG_IGN)
    gc.freeze()  # and need not search everything for garbage
    sys.exit(code)


def exit_code_of(app: typer.Typer, arguments: Sequence[str]) -> int:
    """Run a command, print any error as a message, and return the exit code. Never raises."""
    _open_missing_streams()
    _unwind_on_signals()
    began_s = time.monotonic()
    try:
        require_own_packages()
        set_log_levels_from_environment()
        with _restrict_new_files():
            code = _invoke(app, arguments)
        sys.stdout.flush()
    except (KeyboardInterrupt, typer.Abort):  # the latter at a prompt
        code = EXIT_INTERRUPTED
    except SystemExit as exit_request:  # the reader of a pipe closed it while the command was printing
        code = exit_request.code if isinstance(exit_request.code, int) else EXIT_FAILED
    except BrokenPipeError:
        code = EXIT_FAILED
    except Exception as problem:
        code = _report(problem, verbose=VERBOSE_FLAG in arguments)
    if code == EXIT_INTERRUPTED:
        tell("interrupted")
    command_logger().info("ended", exit_code=code, duration_s=round(time.monotonic() - began_s, 3))
    _abandon_unwritable(sys.stdout)
    _abandon_unwritable(sys.stderr)
    return code


def print_json(document: dict[str, Any]) -> None:
    """Print one JSON object on standard output; numbers must be finite."""
    import json

    sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")


@contextlib.contextmanager
def _restrict_new_files() -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(restrict_new_files())
        except ValueError as mistake:
            raise UsageMistake(str(mistake), action="Correct it or unset it.") from mistake
        yield


def _invoke(app: typer.Typer, arguments: Sequence[str]) -> int:
    command = _command_of(app, arguments[0] if arguments else "")
    try:
        outcome = command.main(args=list(arguments), standalone_mode=False)
    except _USAGE_ERROR as mistake:
        if isinstance(mistake, _NO_ARGUMENTS):
            sys.stderr.write(f"{mistake}\n")
            return EXIT_USAGE
        name, parameters = find_selected_command(command, arguments)
        raise convert_usage_error(mistake, name, parameters, arguments) from mistake
    return outcome if isinstance(outcome, int) else EXIT_DONE


def _command_of(app: typer.Typer, requested: str) -> Any:
    """Build the typer command; in a group, only the selected one, since each takes two milliseconds."""

    def name_of(candidate: typer.models.CommandInfo) -> str:
        assert candidate.callback is not None
        return candidate.name or typer.main.get_command_name(candidate.callback.__name__)

    chosen = (candidate for candidate in app.registered_commands if name_of(candidate) == requested)
    is_single = len(app.registered_commands) + len(app.registered_groups) == 1
    return _build_command(app, None if is_single else next(chosen, None))


@cache
def _build_command(app: typer.Typer, only: typer.models.CommandInfo | None) -> Any:
    if only is None:
        return with_common_options(typer.main.get_command(app))
    group = copy.copy(app)
    group.registered_commands, group.registered_groups = [only], []
    return with_common_options(typer.main.get_group(group))


def _report(problem: Exception, *, verbose: bool) -> int:
    _name_full_output(problem)
    error = as_ronna_error(problem)
    log_failure(problem, error)
    if verbose:
        import traceback

        with contextlib.suppress(OSError):
            traceback.print_exception(problem, file=sys.stderr)
    if not error.shown:
        fail_with(error)
    return error.exit_code


def _name_full_output(problem: Exception) -> None:
    """Name standard output in an error without a file, if it is what cannot be written."""
    if isinstance(problem, OSError) and problem.filename is None:
        try:
            sys.stdout.flush()
        except OSError as again:
            if again.errno == problem.errno:
                problem.filename = "standard output"


def _open_missing_streams() -> None:
    """Replace standard streams that the shell has closed, which Python sets to None."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115


def _unwind_on_signals() -> None:
    # SIGINT too: a shell starts background commands with it ignored, but an arm must stop on it
    if threading.current_thread() is threading.main_thread():
        for number in ENDING_SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:  # by nohup
                signal.signal(number, signal.default_int_handler)


def _abandon_unwritable(stream: TextIO) -> None:
    """Discard output rejected by a full disk or closed pipe, so that the interpreter exits quietly."""
    try:
        stream.flush()
    except (OSError, ValueError):
        with contextlib.suppress(OSError, ValueError):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, stream.fileno())
            os.close(null)
