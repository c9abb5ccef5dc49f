"""A command runs linear algebra on one thread and collects no garbage at its start."""

from __future__ import annotations

import gc
import os
import subprocess
import sys

import pytest

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
