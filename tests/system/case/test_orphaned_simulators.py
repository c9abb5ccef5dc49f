"""No simulator outlives the process that started it, however early that process dies."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ronna_hw.host.child_process import command

END_LIMIT_S = 60.0  # on a busy computer; 2 s where there is time
# Starts a simulator, tells its id, and dies after a while without a word.
PARENT = """
import os, subprocess, sys, time
child = subprocess.Popen(sys.argv[2:], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
print(child.pid, flush=True)
time.sleep(float(sys.argv[1]))
os._exit(0)
"""


def _runs(pid: int) -> bool:
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.parametrize("lifetime_s", [pytest.param(0.0, marks=pytest.mark.slow), 0.1])
@pytest.mark.parametrize("device", ["polaris", "theatre"])
def test_a_simulator_ends_and_gives_the_reason_when_its_parent_dies_during_start_up(
    device: str, lifetime_s: float, tmp_path: Path
) -> None:
    arguments = {
        "polaris": ("polaris", "--endpoint", "tcp://127.0.0.1:0"),
        "theatre": ("theatre", "--scene", "mini", "--out", str(tmp_path)),
    }[device]
    heard = tmp_path / "stderr.txt"
    with heard.open("w") as stderr:
        parent = subprocess.run(
            [sys.executable, "-c", PARENT, str(lifetime_s), *command("sim.cli", *arguments)],
            stdout=subprocess.PIPE, stderr=stderr, text=True, timeout=30, check=True,
        )  # fmt: skip
    pid = int(parent.stdout)
    deadline = time.monotonic() + END_LIMIT_S
    try:
        while _runs(pid):
            assert time.monotonic() < deadline, "the simulator lives on"
            time.sleep(0.05)
    finally:
        if _runs(pid):
            os.kill(pid, signal.SIGKILL)
    assert heard.read_text() == "stopping: the parent process has ended\n"
