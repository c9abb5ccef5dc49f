"""CT slices by DCMTK's dcmsend to our receiver, and to DCMTK's bare one, which checks and flushes nothing."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.figures import Figure, compare_samples

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests/support/imaging"))

from painted_ct import write_series

SLICES, SIDE, ROUNDS = 60, 512, 5
SMALLEST = 4, 64, 1
MEGABYTE = 1e6
LEAST_MB_S, LEAST_SHARE = 50.0, 0.7  # either: a bare receiver may be slower than the first on this computer
START_S = 60.0  # only ends what hangs
HOST = "127.0.0.1"
DCMTK = {"PATH": os.defpath}  # pynetdicom has programs of the same names in our environment
OURS, BARE = "ronna-dicom receive", "storescp of DCMTK"


def measure(smallest: bool = False) -> list[Figure]:
    slices, side, rounds = SMALLEST if smallest else (SLICES, SIDE, ROUNDS)
    samples: dict[str, list[float]] = {OURS: [], BARE: []}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        noise = np.random.default_rng(1).integers(-1000, 1000, (slices, side, side), np.int16)
        sent = write_series(folder / "sent", noise)
        (folder / "bare").mkdir()
        ports = {OURS: _free_port(), BARE: _free_port()}
        ours = [str(Path(sys.executable).parent / "ronna-dicom"), "receive", "--out", str(folder / "inbox")]
        with (
            _listening([*ours, "--port", str(ports[OURS])], ports[OURS]),
            _listening(["storescp", "-od", str(folder / "bare"), str(ports[BARE])], ports[BARE]),
        ):
            for _ in range(rounds):
                for who, port in ports.items():
                    samples[who].append(slices * 2 * side**2 / MEGABYTE / _send_s(sent, port))
    figures = compare_samples("CT slices received", "MB/s", samples, BARE)
    return [_with_goal(one) if one.who == OURS else one for one in figures]


def _with_goal(figure: Figure) -> Figure:
    return figure.at_least(LEAST_MB_S) if figure.value >= LEAST_MB_S else figure.ratio_at_least(LEAST_SHARE)


def _send_s(folder: Path, port: int) -> float:
    began_s = time.perf_counter()
    _run(["dcmsend", "-aec", "RONNA", HOST, str(port), "--scan-directories", str(folder)])
    return time.perf_counter() - began_s


def _run(line: Sequence[str]) -> None:
    subprocess.run(line, env=DCMTK, check=True, capture_output=True, timeout=START_S)


@contextmanager
def _listening(line: Sequence[str], port: int) -> Iterator[None]:
    environment = DCMTK if not Path(line[0]).is_absolute() else None
    process = subprocess.Popen(line, env=environment, stdout=subprocess.DEVNULL)
    try:
        deadline_s = time.monotonic() + START_S
        while not _is_listening(port):
            if process.poll() is not None or time.monotonic() > deadline_s:
                raise RuntimeError(f"{line[0]} does not listen")
        yield
    finally:
        process.terminate()
        process.wait(START_S)


def _is_listening(port: int) -> bool:
    """Return whether a socket of this computer listens at the port, without connecting to it."""
    table = Path("/proc/net/tcp").read_text(encoding="ascii")
    return bool(re.search(rf":{port:04X} 00000000:0000 0A ", table))


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
