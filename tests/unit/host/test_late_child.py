"""A child that does not become ready: the whole limit is told, and that the computer may be busy."""

import sys
import time

import pytest

from ronna_hw.host.child_process import ChildNotReady, ChildProcess


def test_of_a_limit_shared_with_others_the_whole_is_told_not_the_rest() -> None:
    child = ChildProcess("late", [sys.executable, "-c", "import time; time.sleep(60)"], timeout_s=None)
    with pytest.raises(ChildNotReady, match="late did not become ready; limit 8 s") as caught:
        child.await_ready(8.0, 0.1, since=time.monotonic() - 9.0)
    assert "if this computer is busy" in caught.value.advice
    assert not child.alive
