"""Runs commands that end by themselves, within a time limit; a halted one is noticed earlier."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Sequence

from ronna_hw.host.child_process import HANGS, IDLE_TIMEOUT_S, TOO_SLOW, ChildNotReady
from ronna_hw.host.interruption import children_uninterrupted
from ronna_hw.host.processor_use import ProcessorUse

LOOK_AGAIN_S = 0.1  # host time


def finished_command(name: str, arguments: Sequence[str], limit_s: float) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, whatever its exit code, as `await_end`."""
    with children_uninterrupted():
        process = subprocess.Popen(
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
    with process:
        output, messages = await_end(name, process, limit_s)
    return subprocess.CompletedProcess(arguments, process.returncode, output, messages)


def await_end(
    name: str, process: subprocess.Popen[str], limit_s: float, meanwhile: Callable[[], None] = lambda: None
) -> tuple[str, str]:
    """Output and messages of a command that ends by itself; `meanwhile` is called several times a second.

    Raises PRC-001 if it takes longer than `limit_s` or stops using the processor, and ends it then.
    """
    deadline_s, use = time.monotonic() + limit_s, ProcessorUse(process.pid)
    try:
        while True:
            try:
                return process.communicate(timeout=LOOK_AGAIN_S)
            except subprocess.TimeoutExpired:
                meanwhile()
            late, idle = time.monotonic() >= deadline_s, use.idle_s() >= IDLE_TIMEOUT_S
            if late or idle:
                raise ChildNotReady(
                    f"{name} did not finish",
                    limit=f"{limit_s:g} s" if late else f"{IDLE_TIMEOUT_S:g} s without using the processor",
                    action=TOO_SLOW if late else HANGS,
                )
    except BaseException:  # also an interruption: nothing is left running
        process.kill()
        process.wait()
        raise
