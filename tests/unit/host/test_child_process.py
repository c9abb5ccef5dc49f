"""A child that does not become ready: the error gives its limit and whether it did any work."""

from __future__ import annotations

import sys
import time

import pytest

from ronna_hw.host.child_process import READY_TIMEOUT_S, ChildNotReady, ChildProcess


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
