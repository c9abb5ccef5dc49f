"""The simulated cameras as a process, driven over UDP by a client that is written here from the standard."""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from ronna_hw.host.child_process import STOP_TIMEOUT_S, ChildProcess, command
from sim.theatre.scene.named_scenes import named_scene
from sim.theatre.world import World

LIMIT_S = 30.0
CCP, HEARTBEAT, SCP, SCPS, SCDA = 0xA00, 0x938, 0xD00, 0xD04, 0xD18
RECEIVE_BUFFER_BYTES = 8 << 20


class Client:
    """A client of one camera; it finds the addresses of features in the camera's own description."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(LIMIT_S)
        self.stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        self.stream.bind(("127.0.0.1", 0))
        self.stream.settimeout(LIMIT_S)
        self._request = 0
        self._places: dict[str, int] = {}

    def close(self) -> None:
        self.write(CCP, 0)
        self._socket.close()
        self.stream.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def ask(self, code: int, payload: bytes = b"") -> tuple[int, bytes]:
        self._request = self._request % 0xFFFF + 1
        header = struct.pack(">BBHHH", 0x42, 1, code, len(payload), self._request)
        self._socket.sendto(header + payload, (self.address, 3956))
        answer, sender = self._socket.recvfrom(2048)
        assert sender == (self.address, 3956)
        status, answered, length, request = struct.unpack_from(">HHHH", answer)
        assert (answered, length, request) == (code + 1, len(answer) - 8, self._request)
        return status, answer[8:]

    def read(self, address: int) -> int:
        status, content = self.ask(0x80, struct.pack(">I", address))
        assert status == 0
        return int(struct.unpack(">I", content)[0])

    def write(self, address: int, value: int) -> int:
        return self.ask(0x82, struct.pack(">II", address, value))[0]

    def memory(self, address: int, size: int) -> bytes:
        content = b""
        while len(content) < size:
            count = min(536, -(-(size - len(content)) // 4) * 4)
            status, data = self.ask(0x84, struct.pack(">IHH", address + len(content), 0, count))
            assert status == 0
            content += data[4:]
        return content[:size]

    def place(self, name: str) -> int:
        """Address of a feature's register."""
        if not self._places:
            from xml.etree import ElementTree

            url = self.memory(0x200, 512).rstrip(b"\0").decode()
            _, address, length = url.split(";")
            nodes = {
                node.get("Name"): node
                for node in ElementTree.fromstring(self.memory(int(address, 16), int(length, 16)))
            }
            for node_name, node in nodes.items():
                register = nodes.get(node.findtext("{*}pValue"))
                if register is not None and node_name is not None:
                    self._places[node_name] = int(register.findtext("{*}Address", ""), 16)
        return self._places[name]

    def set(self, name: str, value: int) -> None:
        assert self.write(self.place(name), value) == 0, name

    def begin(self, *, trigger: bool, width: int = 2048, height: int = 1088) -> None:
        """Take control, ask for 8 kB packets, start."""
        assert self.write(CCP, 2) == 0
        self.set("Width", width)
        self.set("Height", height)
        self.set("TriggerMode", int(trigger))
        assert self.write(SCPS, 8000) == 0
        assert self.write(SCDA, 0x7F000001) == 0
        assert self.write(SCP, self.stream.getsockname()[1]) == 0
        self.set("TLParamsLocked", 1)
        self.set("AcquisitionStart", 1)

    def frame(self) -> dict[int, bytes]:
        """Packets of the next frame by their id, until its trailer has come."""
        packets: dict[int, bytes] = {}
        while True:
            packet = self.stream.recv(65536)
            word = struct.unpack_from(">I", packet, 4)[0]
            packets[word & 0xFFFFFF] = packet
            if word >> 24 == 2:
                return packets


def leader(packet: bytes) -> dict[str, int]:
    names = ("info", "type", "stamp", "format", "width", "height", "x", "y")
    return dict(zip(names, struct.unpack_from(">HHQIIIII", packet, 8), strict=True))


def image(packets: dict[int, bytes]) -> np.ndarray:
    first = leader(packets[0])
    data = b"".join(packets[number][8:] for number in range(1, max(packets)))
    return np.frombuffer(data, np.uint8).reshape(first["height"], first["width"])


@pytest.fixture(scope="module")
def cameras() -> Iterator[ChildProcess]:
    """One simulator for many clients: whatever they leave behind must not disturb the next."""
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler")) as child:
        yield child


def addresses(cameras: ChildProcess) -> list[str]:
    return [cameras.ready["endpoints"][side].removeprefix("gev://") for side in ("left", "right")]


def test_ready_names_the_endpoints_of_both_cameras(cameras: ChildProcess) -> None:
    assert cameras.ready["device"] == "basler"
    assert set(cameras.ready["endpoints"]) == {"left", "right"}
    assert all(address.startswith("127.77.") for address in addresses(cameras))


def test_a_triggered_pair_shows_the_sphere_of_the_bench(cameras: ChildProcess) -> None:
    left, right = (Client(address) for address in addresses(cameras))
    with left, right:
        for client in (left, right):
            client.begin(trigger=True)
        for number in (1, 2):
            for client in (left, right):
                client.set("TriggerSoftware", 1)
            pair = [client.frame() for client in (left, right)]
            assert all(struct.unpack_from(">H", packets[0], 2)[0] == number for packets in pair)
            stamps = [leader(packets[0])["stamp"] for packets in pair]
            assert abs(stamps[1] - stamps[0]) < 125_000_000 // 2
            for packets in pair:
                pixels = image(packets)
                assert pixels[500:590, 980:1070].mean() > 150
                assert pixels[:50].mean() < 20
            assert not np.array_equal(*(image(packets) for packets in pair))


def test_in_lock_step_pairs_take_theatre_time_and_no_more() -> None:
    world = World.create(named_scene("bench"), paced=False)
    arguments = command("sim.cli", "basler", "--world", world.endpoint)
    with ChildProcess("ronna-sim basler", arguments) as cameras:
        left, right = (Client(address) for address in addresses(cameras))
        with left, right:
            for client in (left, right):
                client.begin(trigger=True, width=640, height=480)
            begun_ns = world.clock.now_ns()
            for _ in range(10):
                for client in (left, right):
                    client.set("TriggerSoftware", 1)
                first, second = (leader(client.frame()[0])["stamp"] for client in (left, right))
                assert 0 <= second - first <= 125_000  # one millisecond
            frame_ns = 4_000_000 + 480 * 20_000_000 / 1088
            assert 10 * frame_ns <= world.clock.now_ns() - begun_ns + 100 <= 10 * (frame_ns + 1_000_000) + 200


def test_it_ends_in_time_while_it_streams_and_the_same_trigger_gives_the_same_image(
    cameras: ChildProcess,
) -> None:
    images = []
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler")) as others:
        assert set(addresses(others)).isdisjoint(addresses(cameras))
        for pair in (cameras, others):
            with Client(addresses(pair)[1]) as client:
                client.begin(trigger=True, width=640, height=480)
                client.set("TriggerSoftware", 1)
                images.append(image(client.frame()).tobytes())
        with Client(addresses(others)[0]) as client:
            client.begin(trigger=False)
            client.frame()
            begun = time.monotonic()
            others.process.terminate()
            assert others.process.wait(LIMIT_S) == 0
            assert time.monotonic() - begun < STOP_TIMEOUT_S
            client.address = addresses(cameras)[0]  # nobody is left to be told goodbye
    assert images[0] == images[1]


def test_it_ends_with_its_parent() -> None:
    line = command("sim.cli", "basler")
    script = f"import subprocess, time; subprocess.Popen({line!r}); time.sleep(60)"
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    with parent:
        assert parent.stdout is not None
        ready = json.loads(parent.stdout.readline().removeprefix("READY "))
        address = ready["endpoints"]["left"].removeprefix("gev://")
        parent.kill()
        begun = time.monotonic()
        # Its address is free again as soon as it has ended.
        while True:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                try:
                    probe.bind((address, 3956))
                    break
                except OSError:
                    assert time.monotonic() - begun < LIMIT_S
            time.sleep(0.05)
    assert time.monotonic() - begun < STOP_TIMEOUT_S


def test_given_addresses_are_used_and_taken_ones_refused() -> None:
    given = ("--address", "127.76.5.1", "--address", "127.76.5.2")
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler", *given)) as cameras:
        assert addresses(cameras) == ["127.76.5.1", "127.76.5.2"]
        second = subprocess.run(command("sim.cli", "basler", *given), capture_output=True, text=True)
        assert second.returncode == 4
        assert "SIM-004" in second.stderr
        assert "127.76.5.1 is in use" in second.stderr


@pytest.mark.parametrize("given", [("127.76.6.1",), ("127.76.6.1", "127.76.6.1")])
def test_one_address_is_a_usage_mistake(given: tuple[str, ...]) -> None:
    options: list[Any] = [part for address in given for part in ("--address", address)]
    ended = subprocess.run(command("sim.cli", "basler", *options), capture_output=True, text=True)
    assert ended.returncode == 2
    assert len(ended.stderr.strip().splitlines()) <= 2
    assert "address" in ended.stderr


def test_an_unknown_scene_is_told() -> None:
    ended = subprocess.run(
        command("sim.cli", "basler", "--scene", "nowhere.toml"), capture_output=True, text=True
    )
    assert ended.returncode == 2
    assert "SIM-001" in ended.stderr
