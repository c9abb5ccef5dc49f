"""Execution of study units in this process, on this computer's cores, or on a Dask cluster.

A user method that does not respond is named: an endless loop looks like long work.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import Any
from urllib.parse import urlsplit

from ronna_hw.errors import RonnaError
from ronna_hw.host.process import limit_children_to_one_thread
from ronna_hw.host.worker_processes import start_workers
from studies.campaign.folder import Ledger
from studies.campaign.study import Study, Sums, Unit
from studies.errors import (
    EXTRA_MISSING,
    SCHEDULER_UNREACHABLE,
    UNIT_FAILED,
    MethodAnswerWrong,
    MethodFailed,
    MethodRefused,
)
from studies.plugins.method import PluginMethod

SILENT_S = 10.0
Tell = Callable[[str], None]
PROCESS_ENDED = "ended its process: os._exit, a crash in compiled code, or out of memory"
SCHEDULER_LIMIT_S = 10.0
SCHEDULER_SCHEMES = ("tcp", "tls", "ws", "wss")
Finished = Iterator[tuple[Unit, Sums]]


def run_study(
    study: Study,
    ledger: Ledger,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float], None] = lambda share: None,
    tell: Tell = lambda text: None,
) -> None:
    """Run the missing units and record them. `workers=1` uses this process, and None all cores.

    User methods always run in other processes: a crash there does not end the campaign, and `tell` is called
    with the name of one that does not respond. Raises STU-003 to STU-005, for user methods STU-012 to
    STU-014. Units finished before an error or an interruption are kept.
    """
    missing = ledger.missing()
    everything = len(study.units())
    done = everything - len(missing)
    progress(done / everything)
    with _runner(study, missing, workers, scheduler, tell) as finished:
        for unit, sums in finished:
            ledger.add(unit, sums)
            done += 1
            progress(done / everything)


class SilenceWatch:
    """Monitor that reports, once each, the units running for longer than `limit_s`."""

    def __init__(self, names: Sequence[str], tell: Tell, limit_s: float = SILENT_S) -> None:
        """Monitor the user methods called `names`; without any names, nothing is reported."""
        self._names, self._tell, self.limit_s = " or ".join(names), tell, limit_s
        self._since: dict[str, float] = {}
        self._announced: set[str] = set()

    def report_silent(self, keys: Iterable[str]) -> None:
        """Report overdue units. Call at least every `limit_s` with the keys of the running ones."""
        now_s = time.monotonic()
        since = {key: self._since.get(key, now_s) for key in keys}
        self._since = since
        for key in since.keys() - self._announced:
            if self._names and now_s - since[key] >= self.limit_s:
                self._announced.add(key)
                self._tell(
                    f"{self._names} has not answered for {self.limit_s:g} s, in {key}; Ctrl-C stops it"
                )


@contextmanager
def _runner(
    study: Study, units: list[Unit], workers: int | None, scheduler: str | None, tell: Tell
) -> Iterator[Finished]:
    if scheduler is not None:
        with _dask_client(scheduler) as client:
            for file in dict.fromkeys(one.source for one in _list_plugins(study)):
                if file is not None:
                    client.upload_file(str(file))
            yield _on_dask(client, study, units)
    elif workers == 1 and not _list_plugins(study):
        yield ((unit, _take_result(unit, partial(study.run, unit))) for unit in units)
    else:
        count = workers or len(os.sched_getaffinity(0))
        with limit_children_to_one_thread(), start_workers(count) as pool:
            yield _on_pool(
                pool, study, units, count, SilenceWatch([one.name for one in _list_plugins(study)], tell)
            )


def _list_plugins(study: Study) -> tuple[PluginMethod, ...]:
    """Return a study's user methods, or an empty tuple if it does not support any."""
    return getattr(study, "own", ())


def _on_pool(
    pool: ProcessPoolExecutor, study: Study, units: list[Unit], count: int, silence: SilenceWatch
) -> Finished:
    waiting = {pool.submit(study.run, unit): unit for unit in units}
    lost = set()
    while waiting:
        silence.report_silent(unit.key for unit in islice(waiting.values(), count))  # they start in order
        for future in wait(waiting, silence.limit_s, FIRST_COMPLETED).done:
            unit = waiting.pop(future)
            if isinstance(future.exception(), BrokenProcessPool):  # so do all others that have not finished
                lost.add(unit.key)
            else:
                yield unit, _take_result(unit, future.result)
    if lost:
        raise _lost_worker_error(study, [unit.key for unit in units if unit.key in lost][:count])


def _lost_worker_error(study: Study, keys: list[str]) -> RonnaError:
    """Build the error for a lost worker, listing the units that it may have been running."""
    among = f", in {' or '.join(keys)}"
    if own := _list_plugins(study):
        return MethodFailed(f"{' or '.join(one.name for one in own)} {PROCESS_ENDED}{among}")
    return UNIT_FAILED(f"a worker process was killed, or ran out of memory{among}")


def _require_address(scheduler: str) -> None:
    """Reject anything but a scheduler address, for which Dask's own client would fail late."""
    try:
        parts = urlsplit(scheduler)
        whole = parts.scheme in SCHEDULER_SCHEMES and parts.hostname and parts.port
    except ValueError:  # an invalid port
        whole = None
    if not whole:
        raise SCHEDULER_UNREACHABLE(
            "not an address of a Dask scheduler", expected="tcp://HOST:PORT", got=scheduler
        )


@contextmanager
def _dask_client(scheduler: str) -> Iterator[Any]:
    _require_address(scheduler)
    try:
        from distributed import Client
    except ImportError as error:
        raise EXTRA_MISSING("the package distributed is not installed") from error
    try:
        client = Client(scheduler, timeout=SCHEDULER_LIMIT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SCHEDULER_UNREACHABLE(f"no Dask scheduler at {scheduler}") from error
    try:
        yield client
    finally:
        client.close()


def _on_dask(client: Any, study: Study, units: list[Unit]) -> Finished:
    from distributed import as_completed as dask_as_completed

    waiting = {client.submit(study.run, unit, pure=False): unit for unit in units}
    futures: Iterable[Any] = dask_as_completed(waiting, loop=client.loop)
    for future in futures:
        yield waiting[future], _take_result(waiting[future], future.result)


def _take_result(unit: Unit, result: Callable[[], Sums]) -> Sums:
    try:
        return result()
    except (MethodAnswerWrong, MethodFailed, MethodRefused) as error:  # the user's own, reported as such
        unit_of_error = f"{error.what}, in unit {unit.key}"
        raise error.reworded(
            unit_of_error, expected=error.expected, got=error.got, action=error.advice
        ) from error
    except Exception as error:
        raise UNIT_FAILED(f"{unit.key}: {error}") from error
