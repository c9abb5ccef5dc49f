"""Two hundred mini cases in a row, each with faults at random, in one process.

However a case ends, it ends in a known state, the arm does nothing after a stop, no process is left, and this
process holds no more than before.
"""

import contextlib
import ctypes
import gc
import json
import logging
import os
import random
import re
import shutil
import signal
import threading
from collections.abc import Iterator
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import pytest
from kills import MOTION_LINKS
from single_faults import STEPS, faults_of, stops
from user_commands import TOKEN, Commands, in_this_process

from procedures.cli.procedure import app as ronna_procedure
from procedures.journal.journal import JOURNAL_FILE, Entry, Line, read_journal
from ronna_hw.devices.capabilities import Direction
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.recording.flight_recorder import BYTES_FOLDER, read_link
from sim.world.faults import parse_faults

pytestmark = [pytest.mark.soak, pytest.mark.timeout(14_400)]

CASES = 200
CASE_S = 42.0  # theatre time of a case without faults
LARGEST_ERROR_MM = 1.5
PROGRAM_FAULT = "CLI-002"
WARM_UP = 10  # cases until every module is imported and every cache is full
LARGEST_GROWTH = 0.05  # of the process's own memory, from there to the end
M_ARENA_MAX = -8  # glibc's malloc.h
C_LIBRARY = ctypes.CDLL(None)
CORRECTIONS = re.compile(rb"<[AR]K(orr)? [^>]*>")


def random_script(seed: int) -> str:
    """One to three faults that begin with a step or at a moment, and end after a while or never."""
    chosen = random.Random(seed)
    lines = []
    for _ in range(chosen.randint(1, 3)):
        device = chosen.choice(tuple(STEPS))
        fault = chosen.choice(sorted(faults_of(device)))
        step, at_s = chosen.choice(STEPS[device]), chosen.uniform(0.0, CASE_S)
        begin = chosen.choice((f"when step == {step}", f"at {at_s:.3f} s"))
        lasting = "" if " for " in fault else chosen.choice(("", f" for {chosen.uniform(0.05, 5.0):.3f} s"))
        if parse_faults(f"now: {device} {fault}")[0].kind.momentary:
            lasting = ""
        lines.append(f"{begin}: {device} {fault}{lasting}\n")
    return "".join(lines)


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch) -> Iterator[Commands]:
    """Everything that this process starts can be found again; its signals are as before in the end."""
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    found = Commands()
    monkeypatch.setenv(TOKEN, found.token)
    try:
        yield found
    finally:
        found.end_all()
        for number, handler in kept.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def uncaptured_logs() -> Iterator[None]:
    """Without the handlers of pytest: they keep every line of every case, 25 MB and more of two hundred."""
    root = logging.getLogger()
    kept, root.handlers = root.handlers, []
    try:
        yield
    finally:
        root.handlers = kept


def assert_known_state(run: Path, outcome: dict[str, object], journal: list[Line]) -> None:
    """Done or failed with a code of ours; every step that began has an end; the folder is whole."""
    kinds = [line["entry"] for line in journal]
    assert kinds[-1] == Entry.CLOSED
    ends = sum(kinds.count(end) for end in (Entry.RESULT, Entry.FAILED, Entry.INTERRUPTED))
    assert kinds.count(Entry.INTENT) == ends
    if outcome["outcome"] == "done":
        error_mm = outcome["max_application_error_mm"]
        assert isinstance(error_mm, float)
        assert error_mm <= LARGEST_ERROR_MM
    else:
        error = outcome["error"]
        assert isinstance(error, dict)
        assert error["code"] != PROGRAM_FAULT, error
        *_, last = stops(journal)
        assert last[-1] is journal[-1]
    assert inspect_run(run).problems == ()


def assert_nothing_moved_after_a_stop(run: Path, journal: list[Line]) -> None:
    """Until the operator leads on: no motion in the journal, and one correction at most on the arm's link."""
    passed = [
        one
        for link in MOTION_LINKS
        for one in read_link(run / BYTES_FOLDER, link)
        if one.direction is Direction.SENT
    ]
    assert passed or all(line["entry"] != Entry.MOVED for line in journal)
    for stop in stops(journal):
        assert all(line["entry"] != Entry.MOTION for line in stop)
        begin, end = (datetime.fromisoformat(str(line["host_time"])) for line in (stop[0], stop[-1]))
        during = [one.data for one in passed if begin < one.host_time <= end]
        assert len({found.group() for data in during if (found := CORRECTIONS.search(data))}) <= 1


def held() -> tuple[int, int, int]:
    """Memory of this process's own in KiB, open files, threads.

    Not its pages of files, which the kernel drops and reads again as it likes, nor freed memory that the C
    library keeps, which grows in steps with the largest case so far.
    """
    gc.collect()
    C_LIBRARY.malloc_trim(0)
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    own_kib = sum(int(status[name].split()[0]) for name in ("RssAnon", "VmSwap"))
    return own_kib, len(os.listdir("/proc/self/fd")), threading.active_count()


def test_two_hundred_cases_with_random_faults_end_in_a_known_state(
    processes: Commands, tmp_path: Path
) -> None:
    # malloc_trim leaves what threads have freed in arenas of their own: 3.8 MB for each that a picture passed
    C_LIBRARY.mallopt(M_ARENA_MAX, 1)
    held_after, failures = [], []
    for seed in range(CASES):
        script = tmp_path / "faults.txt"
        script.write_text(random_script(seed))
        out = tmp_path / str(seed)
        case = ("--scene", "mini", "--seed", seed % 8, "--faults", script, "--out", out)
        with uncaptured_logs():
            ended = in_this_process(ronna_procedure, "run", "--sim", *case, "--json")
        try:
            outcome = json.loads(ended.stdout)
            run = out / outcome["run"]
            journal = list(read_journal(run / JOURNAL_FILE))
            assert_known_state(run, outcome, journal)
            assert_nothing_moved_after_a_stop(run, journal)
            assert processes.await_no_survivors() == []
        except Exception as problem:  # all of them are run, and told together
            failures.append(f"case {seed}: {random_script(seed)}{ended.stderr}{problem!r}")
        else:
            shutil.rmtree(out)
        held_after.append(held())
    assert not failures, "\n\n".join(failures)
    memory, files, threads = zip(*held_after[WARM_UP:], strict=True)
    assert max(files) == files[0]
    assert max(threads) == threads[0]
    lasting = [min(two) for two in pairwise(memory)]  # what the next case frees again is no growth
    assert max(lasting) <= (1 + LARGEST_GROWTH) * memory[0], f"KiB after each case: {memory}"
