"""Cost of journal, events and recorders: the mini case alternately with and without them.

CPU share is reported as well as wall time: on a busy computer it is the more reliable.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from benchmarks.figures import Figure

PROGRAM = Path(__file__).parent / "peers" / "bare_case.py"
SEED = 7
CASE_LIMIT_S = 300.0  # only ends what hangs: a case in real time takes 90 s
ROUNDS = {"max": 5, "1": 2}  # by speed; a round in real time takes a minute and a half
SMALLEST = {"max": 1}
LARGEST_SHARE_PERCENT = {"max": 10.0, "1": 1.0}  # of the wall time
KEPT, BARE = "journal, events, recorders", "without them"


def measure(smallest: bool = False) -> list[Figure]:
    figures = []
    for speed, rounds in SMALLEST.items() if smallest else ROUNDS.items():
        pairs = [(_run_case("kept", speed), _run_case("bare", speed)) for _ in range(rounds)]
        for what, unit in (("wall_s", "wall time"), ("cpu_s", "processor time")):
            share = 100.0 * (median(kept[what] / bare[what] for kept, bare in pairs) - 1.0)
            name = f"cost of a run's history at --speed {speed}, {unit}"
            figure = Figure(name, KEPT, share, "%", more={BARE: median(bare[what] for _, bare in pairs)})
            figures.append(figure.at_most(LARGEST_SHARE_PERCENT[speed]) if what == "wall_s" else figure)
    return figures


def _run_case(kept: str, speed: str) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-P", str(PROGRAM), kept, speed, str(SEED), folder],
            capture_output=True,
            text=True,
            timeout=CASE_LIMIT_S,
            check=False,
        )
    if done.returncode:
        raise RuntimeError(" ".join(done.stderr.split()))
    return dict(json.loads(done.stdout))
