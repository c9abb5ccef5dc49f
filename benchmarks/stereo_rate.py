"""Both cameras full frame, running free at 50 frames/s: our reception and Aravis on the same simulator.

Packets of 8 kB, of which 0.2 % are dropped and repaired. CPU is that of the client alone; ours is that of the
reception process and of the driver, which copies every frame out of the shared memory.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.figures import Figure
from tests.support.camera_stream import lossy_cameras, stream_pairs

PAIRS_PER_ROUND = 600
ROUNDS = 5
PACKET_BYTES = 8000
LOST_PERCENT = 0.2
FULL_RATE_HZ = 50.0
OURS, ARAVIS = "our client", "Aravis"
SYSTEM_PYTHON = "/usr/bin/python3"  # the distribution's own, which alone has Aravis' bindings
PEER = Path(__file__).parent / "peers" / "aravis_stream.py"
ARAVIS_LIMIT_S = 120.0


def measure() -> list[Figure]:
    """Alternating rounds; 3,000 pairs of ours in all."""
    ours, theirs = [], []
    with TemporaryDirectory() as folder, lossy_cameras(Path(folder), LOST_PERCENT) as cameras:
        addresses = [cameras.ready["endpoints"][side].removeprefix("gev://") for side in ("left", "right")]
        for _ in range(ROUNDS):
            ours.append(stream_pairs(addresses, PAIRS_PER_ROUND, PACKET_BYTES))
            theirs.append(_aravis(addresses))
    pairs, seconds = ROUNDS * PAIRS_PER_ROUND, sum(each.seconds for each in ours)
    whole = sum(each.lost + each.broken for each in ours)
    cpu_s = sum(each.reception_cpu_s + each.driver_cpu_s for each in ours)
    figures = [
        Figure("pairs per second, full frames", OURS, pairs / seconds, "1/s"),
        Figure(
            f"frames lost or broken in {pairs:,} pairs",
            OURS,
            whole,
            "frames",
            goal="none",
            met=whole == 0,
            more={"requests for packets": sum(each.repeated for each in ours)},
        ),
        Figure(
            "CPU per pair",
            OURS,
            cpu_s / pairs * 1e3,
            "ms",
            more={"reception process": sum(each.reception_cpu_s for each in ours) / pairs * 1e3},
        ),
    ]
    told = [each for each in theirs if each is not None]
    if not told:
        return figures  # Aravis is not installed here
    done, their_s = len(told) * PAIRS_PER_ROUND, sum(each["seconds"] for each in told)
    their_cpu_ms = sum(each["cpu_s"] for each in told) / done * 1e3
    figures[0] = Figure(
        figures[0].what, OURS, figures[0].value, "1/s", pairs / seconds / (done / their_s), ARAVIS
    )
    figures[2] = Figure(
        figures[2].what,
        OURS,
        figures[2].value,
        "ms",
        figures[2].value / their_cpu_ms,
        ARAVIS,
        figures[2].more,
    )
    return [
        *figures,
        Figure(figures[0].what, ARAVIS, done / their_s, "1/s"),
        Figure(f"frames lost or broken in {done:,} pairs", ARAVIS, sum(e["broken"] for e in told), "frames"),
        Figure(figures[2].what, ARAVIS, their_cpu_ms, "ms"),
    ]


def _aravis(addresses: list[str]) -> dict[str, Any] | None:
    job = json.dumps({"addresses": addresses, "pairs": PAIRS_PER_ROUND, "packet_bytes": PACKET_BYTES})
    try:
        ended = subprocess.run(
            [SYSTEM_PYTHON, PEER, job],
            check=False,
            capture_output=True,
            text=True,
            timeout=ARAVIS_LIMIT_S,
        )
    except (FileNotFoundError, subprocess.TimeoutExpired):
        return None
    if ended.returncode:
        return None
    told: dict[str, Any] = json.loads(ended.stdout)
    return told
