"""Worker processes for computations: spawned afresh, tied to this process, monitored for hangs."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import active_children, parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any, TypeVar

from ronna_hw.host.child_process import IDLE_TIMEOUT_S, POLL_S, ProcessorUse, timeout_error

Result = TypeVar("Result")


@contextmanager
def start_workers(count: int) -> Iterator[ProcessPoolExecutor]:
    """Start `count` workers that end with this process; forking would inherit locks from library threads.

    What they work on is of modules: they do not import the script that this process runs.

    An error or interruption in the block kills them: their work may never end by itself.
    """
    others = active_children()
    with ProcessPoolExecutor(count, _ModulesOnly(), _end_with_parent) as pool:
        try:
            yield pool
        except BaseException:  # above all on interruption: leaving the pool would wait for its workers
            for process in active_children():
                if process not in others:
                    process.kill()
            raise


class _ModulesOnlyProcess(SpawnProcess):
    """Spawned process that does not import the main module: a script without a guard would run again."""

    @staticmethod
    def _Popen(process_obj: Any) -> Any:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")  # has no file, so there is nothing to import
        try:
            return SpawnProcess._Popen(process_obj)
        finally:
            sys.modules["__main__"] = main


class _ModulesOnly(SpawnContext):
    """Context for pools of such processes."""

    Process = _ModulesOnlyProcess


def collect_results(waiting: Sequence[Future[Result]]) -> Iterator[Result]:
    """Yield the results of compute-only workers, in order; raises PRC-001 if none uses the processor."""
    uses = [ProcessorUse(process.pid) for process in active_children() if process.pid is not None]
    for future in waiting:
        while not wait([future], POLL_S).done:
            if all([use.idle_s() >= IDLE_TIMEOUT_S for use in uses]):
                raise timeout_error("the worker processes do not finish", None, IDLE_TIMEOUT_S)
        yield future.result()


def _end_with_parent() -> None:
    """Make a worker exit when its parent is killed, instead of waiting forever for the next task."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; the parent ends its workers
    if (parent := parent_process()) is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
