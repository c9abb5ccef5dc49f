"""The conventions every command shares: messages, exit codes, tables, progress.

Data goes to standard output, messages to standard error. On a terminal errors are coloured and wrapped;
elsewhere they are one unwrapped line. A stack trace is shown only with `--verbose`. The first SIGINT or
SIGTERM unwinds the command through its `finally` blocks and ends it with exit code 130.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TextIO

import typer

from ronna_hw.command_line.errors import UsageMistake, as_ronna_error
from ronna_hw.errors import EXIT_ABORTED, EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED, RonnaError
from ronna_hw.own_packages import require_own_packages

if TYPE_CHECKING:
    from rich.console import Console

FRAME_WIDTH = 3  # of a table's frame, per column
PROGRESS_DELAY_S = 2.0  # shorter work shows no bar

VERBOSE_FLAG = "--verbose"
VerboseOption = Annotated[
    bool, typer.Option(VERBOSE_FLAG, help="Show log lines and, on an error, its trace.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")]

Progress = Callable[[float], None]  # called with the share done, 0 to 1

# the base of typer's usage errors: unknown option, missing argument, bad value
_USAGE_ERROR: type[Exception] = typer.BadParameter.__bases__[0]


def run(app: typer.Typer) -> NoReturn:
    """Run a command with the arguments of this process and end it with the documented exit code."""
    code = exit_code_of(app, sys.argv[1:])
    for number in (signal.SIGINT, signal.SIGTERM):  # the outcome stands; only the interpreter has to end
        signal.signal(number, signal.SIG_IGN)
    sys.exit(code)


def exit_code_of(app: typer.Typer, arguments: Sequence[str]) -> int:
    """Run a command, print any error as a message, and return the exit code. Never raises."""
    _open_missing_streams()
    _unwind_on_signals()
    try:
        require_own_packages()
        code = _invoke(app, arguments)
        sys.stdout.flush()
    except KeyboardInterrupt:
        code = EXIT_INTERRUPTED
    except SystemExit as leaving:  # the reader of a pipe went away while the command was printing
        code = leaving.code if isinstance(leaving.code, int) else EXIT_FAILED
    except BrokenPipeError:
        code = EXIT_FAILED
    except typer.Abort:
        tell("aborted")
        code = EXIT_ABORTED
    except Exception as problem:
        code = _report(problem, verbose=VERBOSE_FLAG in arguments)
    if code == EXIT_INTERRUPTED:
        tell("interrupted")
    _abandon_unwritable(sys.stdout)
    _abandon_unwritable(sys.stderr)
    return code


def fail_with(error: RonnaError) -> None:
    """Print an error as `run` would, for commands that go on after it."""
    line = " ".join(str(error).split())
    if not on_terminal(sys.stderr):
        tell(line)
        return
    from rich.text import Text

    code, _, rest = line.partition(": ") if error.code else ("", "", line)
    with contextlib.suppress(OSError):
        message_console().print(Text.assemble((f"{code} " if code else "", "bold red"), rest))


def tell(line: str) -> None:
    """Print one line of message on standard error; silent when nobody listens any more."""
    with contextlib.suppress(OSError, ValueError):  # nobody listens any more
        sys.stderr.write(line + "\n")
        sys.stderr.flush()


def on_terminal(stream: TextIO) -> bool:
    """True when a person looks at this stream."""
    try:
        return stream.isatty()
    except ValueError:  # closed
        return False


def message_console() -> Console:
    """The rich console for messages (standard error)."""
    from rich.console import Console

    return Console(stderr=True, soft_wrap=not on_terminal(sys.stderr))


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table on standard output: framed where it fits on a terminal, tab-separated lines elsewhere.

    Cells and headings are folded between words only. A word or a number is never cut: where the frame would
    do so, the lines are printed instead.
    """
    table_rows = [list(columns), *([str(cell) for cell in row] for row in rows)]
    widths = _column_widths(table_rows, _terminal_width()) if on_terminal(sys.stdout) else None
    if widths is None:
        for row in table_rows:
            sys.stdout.write("\t".join(row) + "\n")
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, title_justify="left")
    for column, width in zip(columns, widths, strict=True):
        table.add_column(Text(column), width=width, overflow="fold")
    for row in table_rows[1:]:
        table.add_row(*(Text(cell) for cell in row))
    Console().print(table)


def _column_widths(rows: Sequence[Sequence[str]], terminal_width: int) -> list[int] | None:
    """Widths that fill the terminal without cutting a word, headings included; None where none do."""
    by_column = list(zip(*rows, strict=True))
    widths = [_least_width(cells) for cells in by_column]
    wanted = [max(len(line) for cell in cells for line in cell.split("\n")) for cells in by_column]
    spare = terminal_width - 1 - FRAME_WIDTH * len(widths) - sum(widths)
    if spare < 0:
        return None
    for _ in range(spare):  # one more to the column that lacks most
        lacking = [want - width for want, width in zip(wanted, widths, strict=True)]
        if max(lacking, default=0) <= 0:
            break
        widths[lacking.index(max(lacking))] += 1
    return widths


def _least_width(cells: Sequence[str]) -> int:
    """Width that a column needs so that no word of it is folded."""
    return max((len(word) for cell in cells for word in cell.split()), default=0)


def _terminal_width() -> int:
    return shutil.get_terminal_size().columns


def print_json(document: dict[str, Any]) -> None:
    """Print one JSON object on standard output; numbers must be finite."""
    import json

    sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")


@contextlib.contextmanager
def progress_bar(description: str) -> Iterator[Progress]:
    """A bar on standard error for work longer than two seconds; silent off a terminal."""
    if not on_terminal(sys.stderr):
        yield lambda share: None
        return
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    bar = Bar(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=message_console(),
        transient=True,
    )
    task = bar.add_task(description, total=1.0)
    began_s = time.monotonic()
    shown = False

    def advance(share: float) -> None:
        nonlocal shown
        bar.update(task, completed=share)
        if not shown and time.monotonic() - began_s > PROGRESS_DELAY_S:
            shown = True
            bar.start()

    try:
        yield advance
    finally:
        if shown:
            bar.stop()


def set_up_logging(verbose: bool) -> None:
    """Send structured log lines to standard error: all of them with `--verbose`, else only critical ones.

    A command calls this before it starts work; without it log lines would mix with the data.
    """
    import logging
    import warnings

    import structlog

    level = logging.DEBUG if verbose else logging.CRITICAL
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
    # Other people's libraries tell every state and every font at DEBUG: only their warnings are of use.
    logging.basicConfig(level=logging.WARNING if verbose else level, stream=sys.stderr)
    if not verbose:
        warnings.simplefilter("ignore")


def _invoke(app: typer.Typer, arguments: Sequence[str]) -> int:
    command = typer.main.get_command(app)
    try:
        outcome = command.main(args=list(arguments), standalone_mode=False)
    except _USAGE_ERROR as mistake:
        context = getattr(mistake, "ctx", None)
        where = context.command_path if context is not None else command.name
        said = mistake.format_message() if hasattr(mistake, "format_message") else str(mistake)
        raise UsageMistake(said.rstrip("."), action=f"See {where} --help.") from mistake
    return outcome if isinstance(outcome, int) else EXIT_DONE


def _report(problem: Exception, *, verbose: bool) -> int:
    error = as_ronna_error(problem)
    if verbose:
        import traceback

        with contextlib.suppress(OSError):
            traceback.print_exception(problem, file=sys.stderr)
    fail_with(error)
    return error.exit_code


def _open_missing_streams() -> None:
    """A shell may start a command with its streams closed: Python then has None where others write."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115


def _unwind_on_signals() -> None:
    # SIGINT too: a shell starts background commands with it ignored, yet an arm must stop when told
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)


def _abandon_unwritable(stream: TextIO) -> None:
    """Drop what a full disk or a closed pipe refused, so that the interpreter ends without a trace."""
    try:
        stream.flush()
    except (OSError, ValueError):
        with contextlib.suppress(OSError, ValueError):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, stream.fileno())
            os.close(null)
