"""Two full-frame cameras free-running at 50 frames/s: our receiver against Aravis, on the same simulator.

Packets of 8 kB, of which 0.2 % are dropped and repaired. CPU is that of the client alone; ours is that of the
receiver process and of the driver, which copies every frame out of the shared memory. If run as superuser,
both clients are also run without these rights: then they have no priority, and our socket buffer is a quarter
as large. Packets dropped by the kernel because a socket was full are reported next to the losses.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.figures import Figure
from tests.support.devices.camera_stream import lossy_cameras

PAIRS_PER_ROUND = 600
ROUNDS = 5
PACKET_BYTES = 8000
LOST_PERCENT = 0.2
FULL_RATE_HZ = 50.0
RATE_SLACK = 0.01  # of the average rate: the last frame of a round may be late
OURS, ARAVIS = "our client", "Aravis"
ORDINARY = ", ordinary user"
# rights of the superuser: take priority on the processor, exceed the system's largest socket buffer
WITHOUT_RIGHTS = ["setpriv", "--bounding-set=-sys_nice,-net_admin"]
SYSTEM_PYTHON = "/usr/bin/python3"  # the distribution's own, the only one with Aravis' bindings
PEERS = Path(__file__).parents[1] / "peers"
ROUND_LIMIT_S = 120.0
SERVO_AREA_PX = 1024
DRAWINGS = 20
DRAWING_LIMIT_MS = 40.0

Sums = dict[str, float]


def measure(smallest: bool = False) -> list[Figure]:
    """Measure the clients alternately, 3,000 pairs each. Takes about five minutes as superuser."""
    rounds, pairs = (1, 20) if smallest else (ROUNDS, PAIRS_PER_ROUND)
    measured: dict[str, list[Sums]] = {}
    with TemporaryDirectory() as folder, lossy_cameras(Path(folder), LOST_PERCENT) as cameras:
        addresses = [cameras.ready["endpoints"][side].removeprefix("gev://") for side in ("left", "right")]
        job = json.dumps({"addresses": addresses, "pairs": pairs, "packet_bytes": PACKET_BYTES})
        clients = _list_clients()
        for _ in range(rounds):
            for who, line in clients.items():
                measured.setdefault(who, []).append(_run_round([*line, job]))
    return [*_make_figures(measured, pairs), _measure_drawing()]


def _list_clients() -> dict[str, list[str]]:
    """Return the command line of each client, including Aravis only if it is installed."""
    clients = {OURS: [sys.executable, str(PEERS / "our_stream.py")]}
    if _has_aravis():
        clients[ARAVIS] = [SYSTEM_PYTHON, str(PEERS / "aravis_stream.py")]
    if os.geteuid() == 0 and shutil.which(WITHOUT_RIGHTS[0]):
        clients |= {who + ORDINARY: [*WITHOUT_RIGHTS, *line] for who, line in clients.items()}
    return clients


def _has_aravis() -> bool:
    """Return whether the Python bindings are installed; broken ones count, so that they fail later."""
    look = "import importlib.util as u, sys; sys.exit(u.find_spec('gi') is None)"
    if not Path(SYSTEM_PYTHON).exists():
        return False
    return subprocess.run([SYSTEM_PYTHON, "-c", look], check=False).returncode == 0


def _run_round(line: list[str]) -> Sums:
    """Run a client for one round and return its report, adding the kernel's packet drops."""
    dropped = _count_kernel_drops()
    ended = subprocess.run(line, check=False, capture_output=True, text=True, timeout=ROUND_LIMIT_S)
    if ended.returncode:
        raise RuntimeError(f"{' '.join(line[:-1])}: {ended.stderr}")
    received: dict[str, Any] = json.loads(ended.stdout)
    return {**received, "kernel": _count_kernel_drops() - dropped}


def _count_kernel_drops() -> int:
    """Return the number of UDP datagrams dropped since boot because a socket buffer was full."""
    names, values = (
        line.split() for line in Path("/proc/net/snmp").read_text().splitlines() if line.startswith("Udp:")
    )
    return int(dict(zip(names, values, strict=True))["RcvbufErrors"])


def _make_figures(measured: dict[str, list[Sums]], per_round: int) -> Iterator[Figure]:
    for who, rounds in measured.items():
        total, pairs = _add_rounds(rounds), len(rounds) * per_round
        ours = who.startswith(OURS)
        peer = who.replace(OURS, ARAVIS)
        rate = Figure("pairs per second, full frames", who, pairs / total["seconds"], "1/s")
        cpu_ms = total["cpu_s"] / pairs * 1e3
        cpu = Figure("CPU per pair", who, cpu_ms, "ms")
        if ours:
            goal_hz = FULL_RATE_HZ * (1.0 - RATE_SLACK)
            rate = replace(rate, goal=f"{FULL_RATE_HZ:g}", met=rate.value >= goal_hz)
            cpu = replace(cpu, more={"receiver process": total["receiver_cpu_s"] / pairs * 1e3})
            if peer in measured:
                theirs, their_pairs = _add_rounds(measured[peer]), len(measured[peer]) * per_round
                their_hz, their_ms = their_pairs / theirs["seconds"], theirs["cpu_s"] / their_pairs * 1e3
                rate = replace(rate, ratio=rate.value / their_hz, baseline=peer)
                cpu = replace(cpu, ratio=cpu_ms / their_ms, baseline=peer)
        yield rate
        lost_frames = total.get("lost", 0.0) + total["broken"]
        loss = Figure(f"images lost or broken in {pairs:,} pairs", who, lost_frames, "images")
        yield replace(loss, goal="none", met=lost_frames == 0) if ours else loss
        yield Figure(f"packets or ranges requested again in {pairs:,} pairs", who, total["repeated"], "")
        yield Figure(f"datagrams dropped at a full socket in {pairs:,} pairs", who, total["kernel"], "")
        yield cpu


def _add_rounds(rounds: list[Sums]) -> Sums:
    return {name: sum(each[name] for each in rounds) for name in rounds[0]}


def _measure_drawing() -> Figure:
    from sim.basler.camera.photographer import Photographer
    from sim.basler.optics.canvas import Area
    from sim.basler.settings import CameraSettings
    from sim.world.scene.named_scenes import draw_scene
    from sim.world.world import World

    scene = draw_scene("bench")
    photographer = Photographer(World.create(scene, paced=False), scene.left)
    frame = replace(CameraSettings().frame(), area=Area(512, 32, SERVO_AREA_PX, SERVO_AREA_PX))
    spent_ms = []
    for number in range(DRAWINGS):
        began_s = time.process_time()
        photographer.triggered(frame, number)
        spent_ms.append((time.process_time() - began_s) * 1e3)
    what, more = f"drawing {SERVO_AREA_PX} x {SERVO_AREA_PX} px on demand, CPU", {"largest": max(spent_ms)}
    return Figure(what, "simulator", median(spent_ms), "ms", more=more).at_most(DRAWING_LIMIT_MS)
