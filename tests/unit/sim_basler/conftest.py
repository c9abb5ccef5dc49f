"""A camera on a clock that stands still, with images that cost nothing, and what a client would send it."""

from __future__ import annotations

import itertools
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from ronna_hw.wire.gige_vision import Bootstrap
from sim.basler.control.bootstrap import Identity
from sim.basler.control.feature_table import address_of
from sim.basler.device import SimulatedCamera
from sim.basler.settings import FrameSettings, TriggerMoments

CLIENT = ("127.0.0.1", 40001)
OTHER = ("127.0.0.1", 40002)
OK = 0


class StillClock:
    """Theatre time that only a wait advances, as in lock-step."""

    paced = False

    def __init__(self) -> None:
        self.time_ns = 1_000_000_000

    def now_ns(self) -> int:
        return self.time_ns

    def wait_until_ns(self, moment_ns: int) -> None:
        self.time_ns = max(self.time_ns, moment_ns)


class HostSeconds:
    """The host's clock, moved by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class PlainImages:
    """Images whose bytes tell their number. A trigger's image waits for the gate."""

    def __init__(self) -> None:
        self.gate = threading.Event()
        self.gate.set()
        self.where: bytes | None = None

    def place(self) -> bytes | None:
        return self.where

    def triggered(self, frame: FrameSettings, number: int) -> bytes:
        assert self.gate.wait(10.0)
        return bytes([number % 256]) * frame.payload_bytes

    def running(self, frame: FrameSettings, number: int) -> tuple[FrameSettings, bytes]:
        return frame, bytes([number % 256]) * frame.payload_bytes


@dataclass
class Bench:
    """One camera, its surroundings, and the requests of a client."""

    camera: SimulatedCamera
    clock: StillClock
    host_s: HostSeconds
    images: PlainImages
    receiver: socket.socket
    moments: TriggerMoments
    ids: Iterator[int] = field(default_factory=lambda: itertools.count(1))

    def ask(
        self, command: int, payload: bytes = b"", *, peer: tuple[str, int] = CLIENT, flags: int = 1
    ) -> tuple[int, int, bytes]:
        """Status, answer code and content."""
        answer = self.camera.port.answer(self.datagram(command, payload, flags=flags), peer)
        assert answer is not None
        status, code, length, _ = struct.unpack_from(">HHHH", answer)
        assert length == len(answer) - 8
        return status, code, answer[8:]

    def datagram(self, command: int, payload: bytes = b"", *, flags: int = 1, request_id: int = 0) -> bytes:
        identifier = request_id or next(self.ids) % 0xFFFF + 1
        return struct.pack(">BBHHH", 0x42, flags, command, len(payload), identifier) + payload

    def read(self, address: int, *, peer: tuple[str, int] = CLIENT) -> int:
        status, _, content = self.ask(0x80, struct.pack(">I", address), peer=peer)
        assert status == OK, f"0x{address:X}: 0x{status:04X}"
        return int(struct.unpack(">I", content)[0])

    def write(self, address: int, value: int, *, peer: tuple[str, int] = CLIENT) -> int:
        return self.ask(0x82, struct.pack(">II", address, value), peer=peer)[0]

    def get(self, name: str) -> int:
        return self.read(address_of(name))

    def get_float(self, name: str) -> float:
        return float(struct.unpack(">f", struct.pack(">I", self.get(name)))[0])

    def set(self, name: str, value: int | float) -> int:
        word = struct.unpack(">I", struct.pack(">f", value))[0] if isinstance(value, float) else value
        return self.write(address_of(name), word)

    def put(self, **features: int | float) -> None:
        """Write features in this order."""
        for name, value in features.items():
            assert self.set(name, value) == OK, name

    def stream(self, **features: int | float) -> None:
        """Take control with small frames, then write features in this order."""
        self.take_control(stream=True)
        self.put(Width=64, Height=48, **features)

    def take_control(self, *, stream: bool = False) -> None:
        assert self.write(Bootstrap.CCP, 2) == OK
        if stream:
            assert self.write(Bootstrap.SCDA, 0x7F000001) == OK
            assert self.write(Bootstrap.SCP, self.receiver.getsockname()[1]) == OK

    def packets(self, count: int) -> list[bytes]:
        return [self.receiver.recv(65536) for _ in range(count)]

    def frame(self) -> list[bytes]:
        """All packets of the next frame."""
        found = self.packets(1)
        while found[-1][4] != 2:
            found += self.packets(1)
        return found

    def shoot(self) -> list[bytes]:
        """Trigger a frame, and return its packets."""
        self.put(TriggerSoftware=1)
        return self.frame()

    def nothing_comes(self) -> bool:
        """True when no packet comes for a while."""
        self.receiver.settimeout(0.05)
        try:
            self.receiver.recv(65536)
        except TimeoutError:
            return True
        else:
            return False
        finally:
            self.receiver.settimeout(30.0)


MakeBench = Callable[..., Bench]


@pytest.fixture
def make_bench() -> Iterator[MakeBench]:
    made: list[Bench] = []

    def make(name: str = "left", serial: str = "21904411", beside: Bench | None = None) -> Bench:
        receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(30.0)
        clock = beside.clock if beside else StillClock()
        host_s, images = HostSeconds(), PlainImages()
        moments = beside.moments if beside else TriggerMoments(clock)
        camera = SimulatedCamera(Identity("127.0.0.1", serial, name), images, clock, moments, now_s=host_s)
        bench = Bench(camera, clock, host_s, images, receiver, moments)
        camera.open()
        made.append(bench)
        return bench

    yield make
    for bench in made:
        bench.images.gate.set()
        bench.camera.close()
        bench.camera.channel.close()
        bench.camera.messages.close()
        bench.receiver.close()


@pytest.fixture
def bench(make_bench: MakeBench) -> Bench:
    return make_bench()
