"""A function run over a grid of its arguments: in parallel, resumable, into one table.

    from procedures import run_case
    from studies import sweep

    cases = sweep(run_case, scene="mini", seed=range(20), strategy=["ocs", "improved"])
    print(cases.to_pandas().groupby("strategy").error_mm.describe())

A function of your own returns a mapping of columns, several of them, or a loaded run, whose targets become
rows. What raised an error has a row with its code and words: a sweep does not end for one point.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from inspect import getsource, signature
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import Progress

from ronna_hw.arguments import WrongArgument, require_path, show
from ronna_hw.bounded_input import parse_json, read_json_lines
from ronna_hw.errors import RonnaError
from ronna_hw.host.worker_processes import start_workers
from ronna_hw.loaded_run import RunColumn, RunTable
from studies.campaign.folder import code
from studies.errors import LEDGER_UNREADABLE, OTHER_STUDY

FILE = "points.jsonl"  # of finished points, below a line that says which function they are of
RUNS = "runs"  # folder for what the function writes
MAIN = "__main__"  # module of a notebook or script: worker processes cannot import it
ERROR = "error"  # column of what a point was refused with
CORES_PER_POINT = 2  # of a simulated case
Row = dict[str, Any]


def sweep(
    function: Callable[..., Any],
    *,
    folder: str | os.PathLike[str] = "sweep",
    workers: int | None = None,
    progress: bool = True,
    **arguments: object,
) -> RunTable:
    """Call a function for every combination of its `arguments`, and return one table of all results.

    A list, tuple, range or array is varied; any other value is the same in every call. `workers` processes
    work at once, by default one for each two cores, since a simulated case uses two. With 1, all is done in
    this process, as it is by default for a function of a notebook, which no other process can import.

    Finished points are kept in `folder`: the same call, or one with more points, goes on from there. What the
    function writes to its own `out` is kept there too.

    Raises ARG-001 for arguments without a point, STU-001 and STU-002 if `folder` has points of another
    function or of other code, and what the function raises, unless it has a code.
    """
    kept = require_path(folder, "the folder of a sweep")
    points = list(_list_points(arguments))
    if not points:
        raise WrongArgument("the sweep has no point: an argument is empty", got=show(arguments))
    ledger = _Ledger(kept, function)
    missing = [point for point in points if ledger.find(point) is None]
    fixed = _own_options(function, kept / RUNS, arguments)
    with Progress(transient=True, disable=not progress) as bar:
        task = bar.add_task(function.__name__, total=len(points), completed=len(points) - len(missing))
        for point, rows in _run(function, missing, fixed, workers):
            ledger.add(point, rows)
            bar.advance(task)
    return _tabulate([row for point in points for row in ledger.find(point) or ()])


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


def _own_options(function: Callable[..., Any], out: Path, arguments: Mapping[str, object]) -> Row:
    """Return where the function writes, and that it shows no bar of its own, if it can be told."""
    wanted = {"out": out, "progress": False}
    taken = signature(function).parameters
    return {name: value for name, value in wanted.items() if name in taken and name not in arguments}


def _run(
    function: Callable[..., Any], points: Sequence[Row], fixed: Row, workers: int | None
) -> Iterator[tuple[Row, list[Row]]]:
    """Call the function for each point; yield the rows as they are finished."""
    cores = len(os.sched_getaffinity(0))
    count = workers or (max(1, cores // CORES_PER_POINT) if _is_importable(function) else 1)
    if count == 1:
        yield from ((point, _call(function, point, fixed)) for point in points)
        return
    with start_workers(min(count, len(points) or 1)) as pool:
        waiting = {pool.submit(_call, function, point, fixed): point for point in points}
        while waiting:
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                yield waiting.pop(future), future.result()


def _is_importable(function: Callable[..., Any]) -> bool:
    """Whether a worker process finds the function: not one of a notebook, a script or another function."""
    home = None if function.__module__ == MAIN else sys.modules.get(function.__module__)
    return getattr(home, function.__qualname__, None) is function


def _call(function: Callable[..., Any], point: Row, fixed: Row) -> list[Row]:
    """Return the rows of one point. A coded error is a result: it says what a case refused."""
    try:
        found = function(**point, **fixed)
    except RonnaError as error:
        return [{**point, ERROR: str(error)}]
    return [{**point, **row} for row in _as_rows(found)]


def _as_rows(found: Any) -> list[Row]:
    """Return what a function found as rows of plain values."""
    if hasattr(found, "targets") and hasattr(found, "outcome"):  # a loaded run
        plain = [one.name for one in found.targets.columns if not one.size]
        return [
            {"run": found.name, "outcome": found.outcome, **{name: _plain(row[name]) for name in plain}}
            for row in found.targets
        ]
    if isinstance(found, Mapping):
        return [{str(name): _plain(value) for name, value in found.items()}]
    if isinstance(found, list | tuple | Iterator):
        return [row for one in found for row in _as_rows(one)]
    return [{"value": _plain(found)}]


def _plain(value: Any) -> Any:
    plain = value.item() if isinstance(value, np.generic) else value
    if isinstance(plain, float) and not np.isfinite(plain):
        return None
    return plain if isinstance(plain, str | int | float | bool) or plain is None else str(plain)


class _Ledger:
    """Finished points of a function, one line of JSON each, in a folder."""

    def __init__(self, folder: Path, function: Callable[..., Any]) -> None:
        """Open or begin it; raises STU-001 if it is of another function or code, STU-002 if unreadable."""
        self._path = folder / FILE
        self._rows: dict[str, list[Row]] = {}
        folder.mkdir(parents=True, exist_ok=True)
        head = {"function": f"{function.__module__}.{function.__qualname__}", "code": _code_of(function)}
        if not self._path.exists():
            self._append(head)
            return
        content = read_json_lines(self._path)
        whole = content[: content.rfind(b"\n") + 1]  # the last line may be cut
        os.truncate(self._path, len(whole))
        first, *lines = whole.splitlines() or [b""]
        try:
            there = parse_json(first)
            if there != head:
                raise OTHER_STUDY(f"{folder} has points of {there.get('function')} or of other code")
            for line in lines:
                finished = parse_json(line)
                self._rows[finished["point"]] = finished["rows"]
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise LEDGER_UNREADABLE(f"{self._path}: {error}") from error

    def find(self, point: Row) -> list[Row] | None:
        """Return the rows of a point, or None if it is not finished."""
        return self._rows.get(_key(point))

    def add(self, point: Row, rows: list[Row]) -> None:
        self._rows[_key(point)] = rows
        self._append({"point": _key(point), "rows": rows})

    def _append(self, line: Mapping[str, object]) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def _key(point: Row) -> str:
    return json.dumps(point, sort_keys=True, default=str)


def _code_of(function: Callable[..., Any]) -> str:
    """Return a hash of the program and of the function's own lines, where they can be found."""
    try:
        own = getsource(function)
    except (OSError, TypeError):  # typed at a prompt
        own = ""
    return f"{code()}, {hashlib.sha256(own.encode()).hexdigest()[:16]}"


def _tabulate(rows: Sequence[Row]) -> RunTable:
    names = list(dict.fromkeys(name for row in rows for name in row))
    kinds = {name: _kind_of([row.get(name) for row in rows]) for name in names}
    columns = tuple(RunColumn(name, kinds[name], "") for name in names)
    return RunTable.of(columns, [[_cell(row.get(name), kinds[name]) for name in names] for row in rows])


def _kind_of(values: Sequence[object]) -> type:
    if all(isinstance(value, int) and not isinstance(value, bool) for value in values):
        return int
    return float if all(value is None or isinstance(value, int | float) for value in values) else str


def _cell(value: object, kind: type) -> object:
    if value is None:
        return float("nan") if kind is float else ""
    return kind(value)
