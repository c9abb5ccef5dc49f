"""The processes that judge cart positions: halted or orphaned, they do not stay."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from multiprocessing import active_children, get_context
from typing import cast

import psutil
import pytest
from waiting import HANG_LIMIT_S, eventually

from procedures.planning.cart_map import judging
from procedures.planning.cart_place import CartCase, CartMove, Verdict
from ronna_hw.host import worker_processes
from ronna_hw.host.child_process import ChildNotReady

WORKERS = 2
pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class _Unjudged:
    """A case whose positions take for ever."""

    halted: bool

    def judged(self, *_: object, search: bool) -> Verdict:
        if self.halted:
            os.kill(os.getpid(), signal.SIGSTOP)
        while True:
            signal.pause()


def _judge(halted: bool) -> None:
    with judging(cast("CartCase", _Unjudged(halted)), WORKERS) as judge:
        judge([(CartMove(0.0, 0.0), (), False)] * 100)


def test_halted_judges_end_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_processes, "IDLE_TIMEOUT_S", 1.0)
    before = set(active_children())
    with pytest.raises(ChildNotReady, match="PRC-001: the worker processes do not finish"):
        _judge(halted=True)
    assert set(active_children()) <= before


def test_judges_end_with_a_killed_search() -> None:
    search = get_context("spawn").Process(target=_judge, args=(False,))
    search.start()
    seen = psutil.Process(search.pid)
    eventually(lambda: len(seen.children()) == WORKERS)
    judges = seen.children()
    search.kill()
    search.join()
    assert psutil.wait_procs(judges, HANG_LIMIT_S)[1] == []
