"""A function run over a grid of its arguments: in parallel, resumable, into one table.

    from procedures import run_case
    from studies import sweep

    cases = sweep(run_case, scene="mini", seed=range(20), strategy=["ocs", "improved"])
    print(cases.to_pandas().groupby("strategy").error_mm.describe())

A function of your own returns a mapping of columns, several of them, or a loaded run, whose targets become
rows. What raised an error has a row with its code and words: a sweep does not end for one point. The
arguments of all cases are checked before the first one runs.
"""

from __future__ import annotations

import fcntl
import itertools
import os
import pickle
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence, Sized
from concurrent.futures import FIRST_COMPLETED, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

from procedures.from_python import check_run_case, run_case
from procedures.runs.folders import find_runs
from ronna_hw.arguments import WrongArgument, require_path, show
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.command_line.messages import tell, wants_plain_text
from ronna_hw.command_line.options import require_outside_runs
from ronna_hw.errors import ConfigurationError, DataError, RefusedError, RonnaError
from ronna_hw.evidence.manifest import SEAL_FILE
from ronna_hw.host.port_users import find_lock_holder
from ronna_hw.host.process import limit_children_to_one_thread
from ronna_hw.host.worker_processes import start_workers
from ronna_hw.loaded_run import RunColumn, RunTable, load_run
from ronna_hw.text import format_count, format_names
from studies.errors import SWEEP_IN_USE, UNIT_FAILED
from studies.sweep_ledger import FILE, Row, SweepLedger, has_own_name, name_of

RUNS = "runs"  # folder for what the function writes
MAIN = "__main__"  # module of a notebook or script: worker processes cannot import it
ERROR = "error"  # column of what a point was refused with
CORES_PER_POINT = 2  # of a simulated case
OF_RUN = "target_"  # before a column of a run that has the name of an argument


def sweep(
    function: Callable[..., Any],
    *,
    folder: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    progress: bool = True,
    **arguments: object,
) -> RunTable:
    """Call a function for every combination of its `arguments`, and return one table of all results.

    A list, tuple, range or array is varied; any other value is the same in every call. `workers` processes
    work at once, by default one for each two cores, since a simulated case uses two. With 1, all is done in
    this process, as it is for a function of a notebook or script, which no other process can import.

    With a `folder` finished points are kept there: the same call, or one with more points, goes on from
    there. They are of this function's text and of this program; what else the function reads is not compared.
    What the function writes to its own `out` is kept there too.

    A column of a loaded run with the name of an argument is called `target_` and that name.

    Raises ARG-001 for arguments without a point, a result that is none or has a column `error`, and with a
    folder for lambdas, methods of objects and functions inside others, which it cannot tell from one another;
    CLI-005 for a folder inside a run; STU-001 and STU-002 if `folder` has points of another function or of
    other code, STU-005 if a worker process was killed, STU-019 while another sweep writes there; what
    `run_case` says of wrong arguments, and whatever the function raises without a code.
    """
    _check_call(function, arguments, workers)
    kept = None if folder is None else require_path(folder, "the folder of a sweep")
    points = list(_list_points(arguments))
    if not points:
        empty = ", ".join(
            name for name, value in arguments.items() if isinstance(value, Sized) and not len(value)
        )
        raise WrongArgument(
            f"the sweep has no point: {empty} is empty",
            expected="at least one value for each argument",
            got=show(arguments),
            action="Check the list or range that it comes from.",
        )
    if function is run_case:
        for point in points:
            check_run_case(**point)
    with _alone_in(kept):
        _tell_of_cut_off(kept)
        ledger = SweepLedger(kept, function)
        missing = [point for point in points if ledger.find(point) is None]
        if found := len(points) - len(missing):
            tell(f"{found} of {len(points)} points are taken from {kept}")
        fixed = _own_options(function, kept and kept / RUNS, arguments)
        with Progress(
            console=Console(stderr=True), transient=True, disable=not progress or wants_plain_text()
        ) as bar:
            task = bar.add_task(name_of(function), total=len(points), completed=len(points) - len(missing))
            for point, (rows, kept_for_good) in _run(function, missing, fixed, workers):
                ledger.add(point, rows, keep=kept_for_good)
                bar.advance(task)
    rows = [row for point in points for row in ledger.find(point) or ()]
    if refused := sum(bool(row.get(ERROR)) for row in rows):
        tell(f"{refused} of {len(points)} points were refused: their rows say why in {ERROR!r}")
    return _tabulate(rows)


@contextmanager
def _alone_in(folder: Path | None) -> Iterator[None]:
    """Keep other sweeps out of a folder while the block runs. Raises STU-019 while one is in it.

    The lock ends with its process, however that ends.
    """
    if folder is None:
        yield
        return
    require_outside_runs(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        ledger = (folder / FILE).open("ab")
    except OSError as error:
        raise PATH_PROBLEM(
            f"the sweep cannot write into {folder}", expected="a folder", got=error.strerror
        ) from error
    with ledger as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = find_lock_holder(file.fileno())
            number = "" if holder is None else f" (pid {holder.pid})"
            raise SWEEP_IN_USE(f"another sweep{number} is writing into {folder}") from None
        yield


def _tell_of_cut_off(folder: Path | None) -> None:
    """Name the runs that an earlier sweep has left in its folder unfinished, as Ctrl-C does."""
    if folder is None or not (folder / RUNS).is_dir():
        return
    if cut := [run.name for run in find_runs(folder / RUNS) if not (run / SEAL_FILE).exists()]:
        tell(
            f"an earlier sweep was ended during {format_count(len(cut), 'run')} in {folder / RUNS}, which "
            f"belong to no point and may be removed: {format_names(cut)}"
        )


def _check_call(function: object, arguments: Mapping[str, object], workers: object) -> None:
    """Raise ARG-001 for what cannot be called with these arguments, or a number of workers below one."""
    if not callable(function):
        raise WrongArgument(
            "the first argument of sweep is no function",
            expected="a function, without quotes and brackets",
            got=show(function),
        )
    try:
        taken = signature(function)
        taken.bind(**arguments, **_own_options(function, Path(), arguments))
    except TypeError as error:
        raise WrongArgument(
            f"{name_of(function)} cannot be called: {error}",
            expected=f"the arguments {', '.join(taken.parameters) or 'none'}",
            got=", ".join(arguments) or "none",
            action="Give each of its arguments by name: one value, or a list to vary it.",
        ) from error
    if workers is not None and (not isinstance(workers, int) or workers < 1):
        raise WrongArgument(
            "workers of sweep is no number of processes", expected="at least 1, or None", got=show(workers)
        )


def _list_points(arguments: Mapping[str, object]) -> Iterator[Row]:
    choices = [
        list(value) if isinstance(value, list | tuple | range | np.ndarray) else [value]
        for value in arguments.values()
    ]
    for chosen in itertools.product(*choices):
        yield {
            name: value.item() if isinstance(value, np.generic) else value
            for name, value in zip(arguments, chosen, strict=True)
        }


def _own_options(function: Callable[..., Any], out: Path | None, arguments: Mapping[str, object]) -> Row:
    """Return the `out` and `progress` arguments that the function accepts."""
    wanted = {"progress": False} | ({} if out is None else {"out": out})
    taken = signature(function).parameters
    return {name: value for name, value in wanted.items() if name in taken and name not in arguments}


def _run(
    function: Callable[..., Any], points: Sequence[Row], fixed: Row, workers: int | None
) -> Iterator[tuple[Row, tuple[list[Row], bool]]]:
    """Call the function for each point; yield the rows as they are finished."""
    if workers == 1 or not _can_be_sent(function, points):
        yield from ((point, _call(function, point, fixed)) for point in points)
        return
    count = workers or max(1, len(os.sched_getaffinity(0)) // CORES_PER_POINT)
    with limit_children_to_one_thread(), start_workers(min(count, len(points) or 1)) as pool:
        waiting = {pool.submit(_call, function, point, fixed): point for point in points}
        while waiting:
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                point = waiting.pop(future)
                try:
                    yield point, future.result()
                except BrokenProcessPool as error:
                    raise UNIT_FAILED(
                        f"a worker process was killed, or ran out of memory, in {point}",
                        action="Call the sweep again: finished points in its folder= are kept.",
                    ) from error


def _can_be_sent(function: Callable[..., Any], points: Sequence[Row]) -> bool:
    """Return whether worker processes can import all of it: nothing of a notebook, script or function."""
    try:
        return MAIN.encode() not in pickle.dumps((function, points))
    except (pickle.PicklingError, AttributeError, TypeError):
        return False


def _call(function: Callable[..., Any], point: Row, fixed: Row) -> tuple[list[Row], bool]:
    """Return the rows of one point, and whether they are kept.

    A refusal is a result: it says what a case did not accept. A link that failed or a device that did not
    start is none: the next call tries that point again.
    """
    shown = {name: _show_argument(value) for name, value in point.items()}
    try:
        result = function(**point, **fixed)
        found = list(_list_rows(result, shown))
    except RonnaError as error:
        row = {**shown, **_describe_run(error.run), ERROR: str(error)}
        return [row], isinstance(error, RefusedError | DataError | ConfigurationError)
    except Exception as error:  # of the function, whatever it is: it passes through with its point
        error.add_note(f"at the point {shown}")
        raise
    if result is None:
        raise WrongArgument(
            f"the function of the sweep returned None at the point {shown}",
            expected="a number, a mapping of columns, several of them, or a loaded run",
            action="Is its return missing?",
        )
    return [_with_arguments(row, shown) for row in found], True


def _describe_run(folder: Path | None) -> Row:
    """Return name and outcome of the run that a refused case has left."""
    return {} if folder is None else {"run": folder.name, "outcome": load_run(folder).outcome}


def _list_rows(found: Any, arguments: Collection[str]) -> Iterator[Row]:
    """Yield the rows of a function's result: of a loaded run one for each target."""
    if hasattr(found, "targets") and hasattr(found, "outcome"):
        plain = [one.name for one in found.targets.columns if not one.size]
        for target in found.targets:
            row = {"run": found.name, "outcome": found.outcome, **{name: target[name] for name in plain}}
            yield {OF_RUN + name if name in arguments else name: value for name, value in row.items()}
    elif isinstance(found, Mapping):
        yield {str(name): value for name, value in found.items()}
    elif isinstance(found, list | tuple | Iterator):
        for one in found:
            yield from _list_rows(one, arguments)
    else:
        yield {"value": found}


def _with_arguments(row: Row, shown: Row) -> Row:
    """Return the row behind its arguments. Raises ARG-001 for what is no cell of a table."""
    if ERROR in row:
        raise WrongArgument(
            f"the function returns a column {ERROR!r}, in which a sweep says why a point was refused",
            got=show(row[ERROR]),
            action="Rename the column, such as error_mm.",
        )
    plain = {name: _to_cell(name, value, shown) for name, value in row.items()}
    for name, value in plain.items():
        if name in shown and value != shown[name]:
            raise WrongArgument(
                f"the function returns a column {name!r}, which is one of its arguments, with another value",
                expected=show(shown[name]),
                got=show(value),
                action="Rename the column.",
            )
    return {**shown, **plain}


def _to_cell(column: str, value: object, shown: Row) -> object:
    plain = value.item() if isinstance(value, np.generic) else value
    if isinstance(plain, np.ndarray | complex):
        raise WrongArgument(
            f"the column {column!r} has {show(plain)} at the point {shown}",
            expected="numbers or text",
            action="Give each number a column or a row of its own.",
        )
    return _to_plain(plain)


def _show_argument(value: object) -> object:
    return name_of(value) if callable(value) and has_own_name(value) else _to_plain(value)


def _to_plain(value: object) -> object:
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool) or value is None else str(value)


def _tabulate(rows: Sequence[Row]) -> RunTable:
    names = list(dict.fromkeys([*(name for row in rows for name in row), ERROR]))
    kinds = {name: _kind_of([row.get(name) for row in rows]) for name in names} | {ERROR: str}
    columns = tuple(RunColumn(name, kinds[name], "") for name in names)
    return RunTable.of(columns, [[_cell(row.get(name), kinds[name]) for name in names] for row in rows])


def _kind_of(values: Sequence[object]) -> type:
    if all(isinstance(value, bool) for value in values):
        return bool
    if all(isinstance(value, int) and not isinstance(value, bool) for value in values):
        return int
    return float if all(value is None or isinstance(value, int | float) for value in values) else str


def _cell(value: object, kind: type) -> object:
    if value is None:
        return float("nan") if kind is float else ""
    return kind(value)
