"""Free-running simulated cameras received by the driver's own client: rate, CPU, losses."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from drivers.basler_stereo.camera import Camera
from drivers.basler_stereo.options import BaslerOptions
from drivers.basler_stereo.stream.frame_assembler import ReceivedImage
from drivers.basler_stereo.stream.receiver import ReceiverProcess
from ronna_hw.host.child_process import ChildProcess, command

START_LIMIT_S = 30.0
FRAME_LIMIT_S = 30.0
OVERTAKING_FRAMES = 48  # how many later frames may come before one that is still being repaired
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Streamed:
    """Result of receiving a number of pairs. CPU times are those of the client's own processes."""

    pairs: int
    seconds: float
    receiver_cpu_s: float
    driver_cpu_s: float
    lost: int  # images that never came
    broken: int  # images that came with packets missing
    repeated: int  # requests for packets
    packets: int

    @property
    def rate_hz(self) -> float:
        return self.pairs / self.seconds


class _Side:
    """Images of one camera, numbered from the first that is counted."""

    def __init__(self, camera: Camera, pairs: int) -> None:
        self._camera = camera
        first = _frame(camera).block_id  # the first images are being drawn
        self.wanted = set(range(first + 1, first + pairs + 1))
        self.broken = 0

    def take(self) -> None:
        frame = _frame(self._camera)
        if frame.block_id in self.wanted:
            self.wanted.discard(frame.block_id)
            self.broken += frame.missing_packets > 0 or frame.leader is None


@contextmanager
def lossy_cameras(folder: Path, share_percent: float) -> Iterator[ChildProcess]:
    """Simulated cameras on a network that loses that share of their packets."""
    script = folder / "losses.txt"
    script.write_text(f"at 0 s: camera drop {share_percent:g} %\n" if share_percent else "")
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler", "--faults", str(script))) as cameras:
        yield cameras


def stream_pairs(addresses: list[str], pairs: int, packet_bytes: int = 8000) -> Streamed:
    """Receive a number of pairs of full frames, each frame copied out of the shared memory.

    An image counts as lost when its number has not come among the images wanted and those after them.
    """
    options = BaslerOptions(packet_bytes=packet_bytes)
    receiver = ReceiverProcess()
    both = [
        Camera(side, address, options) for side, address in zip(("left", "right"), addresses, strict=True)
    ]
    try:
        for camera in both:
            deadline_s = time.monotonic() + START_LIMIT_S
            camera.connect(deadline_s)
            camera.configure(receiver, deadline_s)
            camera.features.choose("TriggerMode", "Off")
        for camera in both:
            camera.start(time.monotonic() + START_LIMIT_S)
        sides = [_Side(camera, pairs) for camera in both]
        began_s, driver_s, child_s = time.monotonic(), time.process_time(), _cpu_s(receiver.pid)
        for _ in range(pairs):
            for side in sides:
                side.take()
        seconds = time.monotonic() - began_s
        driver_s, child_s = time.process_time() - driver_s, _cpu_s(receiver.pid) - child_s
        for side in sides:
            for _ in range(OVERTAKING_FRAMES):
                if side.wanted:
                    side.take()
        counters = [camera.receiver.counters for camera in both]
        return Streamed(
            pairs,
            seconds,
            child_s,
            driver_s,
            lost=sum(len(side.wanted) for side in sides),
            broken=sum(side.broken for side in sides),
            repeated=sum(each.resend_requests for each in counters),
            packets=sum(each.packets for each in counters),
        )
    finally:
        for camera in both:
            camera.close(time.monotonic() + 2.0)
        receiver.close()


def _frame(camera: Camera) -> ReceivedImage:
    frame = camera.receiver.take(time.monotonic() + FRAME_LIMIT_S)
    assert frame is not None, f"no frame from the {camera.side} camera"
    return frame


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) * _TICK_S
