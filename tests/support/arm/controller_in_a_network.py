"""A program for a network namespace of its own: a controller in one network, a listener in another, a search.

Prints what the search says, and whether anybody knocked at the listener.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from pathlib import Path

from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.wire.kuka_eki import PROJECT_PORT

HERE, CONTROLLER, ELSEWHERE = "10.77.0.1", "10.77.0.4", "10.88.0.4"
PREFIX = 29


def main(file: str) -> None:
    for arguments in (
        ("link", "set", "lo", "up"),
        *(("addr", "add", f"{address}/{PREFIX}", "dev", "lo") for address in (HERE, CONTROLLER, ELSEWHERE)),
    ):
        subprocess.run(("ip", *arguments), check=True)
    simulator = command("sim.cli", "kuka", "--eki-project", f"tcp://{CONTROLLER}:{PROJECT_PORT}")
    search = str(Path(sys.executable).parent / "ronna-procedure")
    with (
        socket.create_server((ELSEWHERE, PROJECT_PORT)) as elsewhere,
        ChildProcess("ronna-sim kuka", simulator),
    ):
        given = ("--interface", HERE, "--no-check", "--out", file)
        done = subprocess.run(
            (search, "new-theatre", *given),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        elsewhere.setblocking(False)
        try:
            elsewhere.accept()
            knocked = True
        except BlockingIOError:
            knocked = False
    print(json.dumps({"code": done.returncode, "said": done.stderr, "knocked": knocked}))


if __name__ == "__main__":
    main(sys.argv[1])
