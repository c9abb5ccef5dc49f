"""The robot controller as a process: signals, its parent's death, a port in use."""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys

from kuka_clients import FREE

from ronna_hw.host.child_process import command


def test_it_ends_within_two_seconds_of_its_parents_death() -> None:
    script = (
        "import subprocess, sys; p = subprocess.Popen([sys.executable, '-P', '-m', 'sim.cli', 'kuka',"
        f" '--eki', '{FREE}', '--eki-project', '{FREE}', '--scene', 'mini'], stdout=subprocess.PIPE);"
        " p.stdout.readline(); print(p.pid, flush=True)"
    )
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True, timeout=20)
    watched = os.pidfd_open(int(done.stdout)) if os.path.exists(f"/proc/{int(done.stdout)}") else None
    if watched is not None:
        assert select.select([watched], [], [], 2.0)[0]
        os.close(watched)


def test_a_port_in_use_is_one_line_and_its_exit_code() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        done = subprocess.run(
            command("sim.cli", "kuka", "--eki", FREE, "--eki-project", endpoint),
            capture_output=True,
            text=True,
            timeout=20,
        )
    assert done.returncode == 4
    assert done.stderr.startswith("SIM-004")
    assert len(done.stderr.splitlines()) == 1
