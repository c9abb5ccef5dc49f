"""One seed two hundred times, under other load that comes and goes: each run gives the same results."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from undisturbed import MINI_SEED_3, undisturbed_mini
from user_commands import Commands

pytestmark = [pytest.mark.soak, pytest.mark.timeout(5400)]

RUNS = 200
SHARES = 8  # each with other work of its own, so that several workers take part
AT_ONCE = 10
SAME = ("ct", "registration", "targets")
CASE_LIMIT_S = 300.0  # host time, on a computer that is busy on purpose
# Works and rests for moments of its own choosing, until the test that started it is gone.
OTHER_WORK = """
import os, random, sys, time
chosen, parent = random.Random(sys.argv[1]), os.getppid()
while os.getppid() == parent:
    until_s = time.monotonic() + chosen.uniform(0.05, 3.0)
    while time.monotonic() < until_s:
        pass
    time.sleep(chosen.uniform(0.05, 3.0))
"""


@pytest.fixture
def other_work(request: pytest.FixtureRequest) -> Iterator[None]:
    """One process for each core that we may use, each busy half of the time on a schedule of its own."""
    words = [sys.executable, "-P", "-c", OTHER_WORK]
    cores = sorted(os.sched_getaffinity(0))
    busy = [subprocess.Popen([*words, f"{request.node.name} {core}"]) for core in cores]
    yield
    for process in busy:
        process.kill()
        process.wait()


@pytest.mark.parametrize("share", range(SHARES))
def test_a_seed_gives_the_same_numbers_under_any_other_load(
    commands: Commands, other_work: None, tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, share: int
) -> None:
    undisturbed = undisturbed_mini(tmp_path_factory)
    for number in range(RUNS // SHARES):
        out = tmp_path / str(number)
        done = commands.run("ronna-procedure", *MINI_SEED_3, "--out", str(out), timeout_s=CASE_LIMIT_S)
        assert done.returncode == 0, done.stderr
        outcome = json.loads(done.stdout)
        for key in SAME:
            assert outcome[key] == undisturbed[key], f"run {number} of share {share}"
        shutil.rmtree(out)


def test_ten_cases_at_once_give_the_same_numbers(
    commands: Commands, tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    undisturbed = undisturbed_mini(tmp_path_factory)

    def run(number: int) -> dict[str, object]:
        out = str(tmp_path / str(number))
        done = commands.run("ronna-procedure", *MINI_SEED_3, "--out", out, timeout_s=CASE_LIMIT_S)
        assert done.returncode == 0, done.stderr
        outcome = json.loads(done.stdout)
        return {key: outcome[key] for key in SAME}

    with ThreadPoolExecutor(AT_ONCE) as pool:
        assert list(pool.map(run, range(AT_ONCE))) == [{key: undisturbed[key] for key in SAME}] * AT_ONCE


@pytest.fixture
def one_core() -> Iterator[None]:
    """Only one core for this process and all that it starts."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    yield
    os.sched_setaffinity(0, allowed)


def test_a_case_on_one_core_gives_the_same_numbers(
    commands: Commands, one_core: None, tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    undisturbed = undisturbed_mini(tmp_path_factory)
    done = commands.run("ronna-procedure", *MINI_SEED_3, "--out", str(tmp_path), timeout_s=CASE_LIMIT_S)
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert {key: outcome[key] for key in SAME} == {key: undisturbed[key] for key in SAME}
