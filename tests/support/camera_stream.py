"""Both simulated cameras running free, received by the driver's own client: rate, CPU, losses."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from drivers.basler_stereo.assembly import Frame
from drivers.basler_stereo.camera import Camera
from drivers.basler_stereo.options import BaslerOptions
from drivers.basler_stereo.reception import Reception
from ronna_hw.child_process import ChildProcess, command

START_LIMIT_S = 30.0
FRAME_LIMIT_S = 10.0
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Streamed:
    """What came of a number of pairs. CPU times are those of the client's own processes."""

    pairs: int
    seconds: float
    reception_cpu_s: float
    driver_cpu_s: float
    lost: int  # block ids that never came
    broken: int  # frames that came with packets missing
    repeated: int  # requests for packets

    @property
    def rate_hz(self) -> float:
        return self.pairs / self.seconds


@contextmanager
def lossy_cameras(folder: Path, share_percent: float) -> Iterator[ChildProcess]:
    """The simulated cameras on a network that loses that share of their packets."""
    script = folder / "losses.txt"
    script.write_text(f"at 0 s: camera drop {share_percent:g} %\n" if share_percent else "")
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler", "--faults", str(script))) as cameras:
        yield cameras


def stream_pairs(addresses: list[str], pairs: int, packet_bytes: int = 8000) -> Streamed:
    """Receive so many pairs of full frames, in order, each frame copied out of the shared memory."""
    options = BaslerOptions(packet_bytes=packet_bytes)
    reception = Reception()
    both = [
        Camera(side, address, options) for side, address in zip(("left", "right"), addresses, strict=True)
    ]
    try:
        for camera in both:
            deadline_s = time.monotonic() + START_LIMIT_S
            camera.connect(deadline_s)
            camera.configure(reception, deadline_s)
            camera.features.choose("TriggerMode", "Off")
        for camera in both:
            camera.start(time.monotonic() + START_LIMIT_S)
        ids = [{_frame(camera).block_id} for camera in both]  # the first images are being drawn
        began_s, driver_s, child_s = time.monotonic(), time.process_time(), _cpu_s(reception.pid)
        broken = 0
        for _ in range(pairs):
            for side, camera in enumerate(both):
                frame = _frame(camera)
                broken += frame.missing_packets > 0 or frame.leader is None
                ids[side].add(frame.block_id)
        # a frame that is still being repaired may be overtaken by the next
        lost = sum(max(0, max(came) - min(came) - len(came)) for came in ids)
        return Streamed(
            pairs,
            time.monotonic() - began_s,
            _cpu_s(reception.pid) - child_s,
            time.process_time() - driver_s,
            lost,
            broken,
            sum(camera.receiver.counters.resend_requests for camera in both),
        )
    finally:
        for camera in both:
            camera.close(time.monotonic() + 2.0)
        reception.close()


def _frame(camera: Camera) -> Frame:
    frame = camera.receiver.take(time.monotonic() + FRAME_LIMIT_S)
    assert frame is not None, f"no frame from the {camera.side} camera"
    return frame


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) * _TICK_S
