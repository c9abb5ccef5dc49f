"""What all tests share."""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import signal
from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from user_commands import Commands

MANY_FILES = 300  # `select` takes numbers up to 1023
TOO_MANY_FILES = 900
MORE_FILES = 150  # than were in use after the last search: so many may be garbage by now

pytest_plugins = ["hazard_ledger", "sim.pytest_plugin"]

settings.register_profile("suite", deadline=None)  # how long an example takes says how busy the computer is
settings.load_profile("suite")

gc.disable()  # while tests are collected, little is garbage


def pytest_collection(session: pytest.Session) -> None:
    """Import a worker's own share of the test modules before all of them are collected.

    Where there is no bytecode yet each worker would otherwise rewrite the assertions of every module.
    """
    if (worker := getattr(session.config, "workerinput", None)) is None:
        return
    root, own = session.config.rootpath, int(worker["workerid"].removeprefix("gw"))
    files = sorted(chain.from_iterable((root / where).rglob("test_*.py") for where in session.config.args))
    for file in files[own :: worker["workercount"]]:
        with contextlib.suppress(Exception, pytest.skip.Exception):  # collecting it tells what is wrong
            importlib.import_module(".".join(file.relative_to(root).with_suffix("").parts))


def pytest_collection_finish() -> None:
    """What was collected stays to the end: from here on no search for garbage looks at it again."""
    gc.freeze()
    gc.set_threshold(50_000)  # a search after every 700 objects finds next to nothing
    gc.enable()


class OpenFiles:
    """How many files may be open before garbage is searched for some to close.

    What is in use stays open: where that is many, a search after every test finds nothing and costs 70 ms.
    """

    def __init__(self) -> None:
        self.most = MANY_FILES

    def close_garbage(self) -> None:
        if _count_files() > self.most:
            gc.collect()
            self.most = min(max(MANY_FILES, _count_files() + MORE_FILES), TOO_MANY_FILES)


def _count_files() -> int:
    return len(os.listdir("/proc/self/fd"))


open_files = OpenFiles()


def pytest_runtest_teardown() -> None:
    """Files of what is garbage are closed before `select` meets numbers that it does not take."""
    open_files.close_garbage()


@pytest.fixture(scope="session")
def hang_ups_count() -> Iterator[None]:
    """Also where the tests themselves run under `nohup`, which a command that they start would inherit."""
    kept = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, kept)


@pytest.fixture
def commands() -> Iterator[Commands]:
    """Commands of one test, as a user runs them; the test fails when any process outlives it."""
    from user_commands import Commands

    started = Commands()
    try:
        yield started
        assert started.await_no_survivors() == []
    finally:
        started.end_all()
