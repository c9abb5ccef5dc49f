"""Log of a run for foreign readers: joints for a second, a pose, a line, a state."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from procedures.live.flight_log import FlightLog
from procedures.live.log_entries import JointCycles, Level, SaidLine
from procedures.live.records import Began, FramePose, RunState

EPOCH_NS = 1_700_000_000_123_456_789
TIMES_S = np.arange(250) / 250
JOINTS_RAD = np.sin(TIMES_S[:, None] + np.arange(6))
POSE_MM = (400.0, 100.0, 700.0)
COUNTS = {
    "/measured_js": 250,
    "/setpoint_js": 250,
    "/measured_cp": 1,
    "/tf": 1,
    "/operating_state": 1,
    "/rosout": 1,
}
BEGAN = Began(theatre_time_s=0.0, run="R1", epoch_ns=EPOCH_NS)
WRITTEN_AND_KILLED = """
import os, signal, sys
import our_log
log = our_log.written(sys.argv[1])
while log.flushed < sum(our_log.COUNTS.values()):
    pass
os.kill(os.getpid(), signal.SIGKILL)
"""


def written(path: str | Path) -> FlightLog:
    """Write the log; it is still open."""
    log = FlightLog(Path(path), BEGAN, str, flush_period_s=0.05)
    log.take(
        [
            JointCycles("master", ("A1", "A2", "A3", "A4", "A5", "A6"), TIMES_S, JOINTS_RAD, JOINTS_RAD),
            FramePose(
                theatre_time_s=1.0,
                parent="robot",
                child="flange",
                rotation=(1.0, 0.0, 0.0, 0.0),
                translation_mm=POSE_MM,
            ),
            SaidLine(2.0, Level.WARNING, "the head has moved"),
            RunState(theatre_time_s=3.0, run="R1", state="idle"),
        ]
    )
    return log


def sealed_log() -> Path:
    path = Path(mkdtemp()) / "flight.mcap"
    written(path).close()
    return path


def killed_log() -> Path:
    """Write the log in a program that is killed once all is flushed."""
    path = Path(mkdtemp()) / "flight.mcap"
    line = [sys.executable, "-c", WRITTEN_AND_KILLED, str(path)]
    subprocess.run(line, cwd=Path(__file__).parent, check=False)
    return path
