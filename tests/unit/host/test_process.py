"""A process: linear algebra on one thread, no garbage collected at its start, how a child process ends."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time

import pytest

from ronna_hw.host.child_process import READY_TIMEOUT_S, ChildNotReady, ChildProcess
from ronna_hw.host.process import (
    resume_garbage_collection,
    suspend_garbage_collection,
)

MULTIPLYING = """
import os, typer
from ronna_hw.command_line import terminal
app = typer.Typer()
@app.command()
def multiply() -> None:
    import numpy as np
    square = np.ones((600, 600))
    square @ square
    print(len(os.listdir("/proc/self/task")))
terminal.run(app)
"""


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one processor has one thread anyway")
def test_linear_algebra_of_a_command_uses_one_thread_on_any_number_of_processors() -> None:
    command = [sys.executable, "-P", "-c", MULTIPLYING]
    done = subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, "OPENBLAS_NUM_THREADS": "2"}
    )
    assert done.stdout == "1\n", done.stderr


def test_objects_are_exempted_from_collection_only_after_a_suspension() -> None:
    exempt = gc.get_freeze_count()
    resume_garbage_collection()
    assert gc.isenabled()
    assert gc.get_freeze_count() == exempt
    suspend_garbage_collection()
    try:
        assert not gc.isenabled()
        resume_garbage_collection()
        assert gc.isenabled()
        assert gc.get_freeze_count() > exempt
    finally:
        gc.unfreeze()


def test_a_limit_shared_with_other_children_is_reported_in_full() -> None:
    child = ChildProcess("late", [sys.executable, "-c", "import time; time.sleep(60)"], timeout_s=None)
    with pytest.raises(ChildNotReady, match="late did not become ready; limit 8 s") as caught:
        child.await_ready(8.0, 0.1, since=time.monotonic() - 9.0)
    assert "if this computer is busy" in caught.value.advice
    assert not child.alive


WORK = "import time\nwhile time.process_time() < 0.8: pass\n"
READY = "print('READY {}', flush=True); time.sleep(60)"
IN_ITS_CHILD = f"import subprocess, sys, time; subprocess.run([sys.executable, '-c', {WORK!r}])\n"


def test_a_child_is_waited_for_while_it_or_its_own_child_uses_the_processor() -> None:
    line = [sys.executable, "-c", IN_ITS_CHILD + WORK + READY]
    with ChildProcess("slow", line, timeout_s=None) as child:
        assert child.await_ready(150.0, idle_s=0.6) == {}


def test_an_idle_child_is_given_up_long_before_the_limit() -> None:
    child = ChildProcess("halted", [sys.executable, "-c", "import time; time.sleep(60)"], timeout_s=None)
    began_s = time.monotonic()
    with pytest.raises(ChildNotReady, match=r"limit 0\.3 s without using the processor"):
        child.await_ready(idle_s=0.3)
    assert time.monotonic() - began_s < READY_TIMEOUT_S / 2
    assert not child.alive
