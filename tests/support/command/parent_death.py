"""A command whose parent is killed: whether it ends in time too, told by its own descriptor."""

from __future__ import annotations

import os
import select
import subprocess
import sys
from collections.abc import Callable, Sequence

from waiting import STALL_OF_THE_COMPUTER_S, eventually

from ronna_hw.host.child_process import STOP_TIMEOUT_S

PARENT = """
import subprocess, sys
child = subprocess.Popen(sys.argv[1:])
print(child.pid, flush=True)
child.wait()
"""


def ends_with_its_parent(arguments: Sequence[str], begun: Callable[[], bool] | None = None) -> bool:
    """Start a command, kill its parent once it is READY, or once it has `begun`, and see it end."""
    line = [sys.executable, "-P", "-c", PARENT, *arguments]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        lines = [parent.stdout.readline()]
        if begun is None:  # READY and the number share a pipe, either may come first
            lines.append(parent.stdout.readline())
            assert any(line.startswith("READY ") for line in lines)
        else:
            eventually(begun)
        child = os.pidfd_open(next(int(line) for line in lines if line.strip().isdigit()))
        parent.kill()
        parent.wait()
        ended, _, _ = select.select([child], [], [], STOP_TIMEOUT_S + STALL_OF_THE_COMPUTER_S)
        os.close(child)
    return bool(ended)
