"""The robot controller as a process: signals, its parent's death, a port in use."""

from __future__ import annotations

import os
import select
import subprocess
import sys

from kuka_clients import FREE


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
