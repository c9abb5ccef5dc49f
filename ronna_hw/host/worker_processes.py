"""Worker processes for computations: spawned afresh, tied to this process, monitored for hangs."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from typing import TypeVar

from ronna_hw.host.child_process import IDLE_TIMEOUT_S, POLL_S, ProcessorUse, timeout_error

Result = TypeVar("Result")


@contextmanager
def start_workers(count: int) -> Iterator[ProcessPoolExecutor]:
    """Start `count` workers that end with this process; forking would inherit locks from library threads.

    An error or interruption in the block kills them: their work may never end by itself.
    """
    others = active_children()
    with ProcessPoolExecutor(count, get_context("spawn"), _end_with_parent) as pool:
        try:
            yield pool
        except BaseException:  # above all on interruption: leaving the pool would wait for its workers
            for process in active_children():
                if process not in others:
                    process.kill()
            raise


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
