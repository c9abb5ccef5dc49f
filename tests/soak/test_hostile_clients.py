"""A malicious client: the simulator keeps serving others, and nothing grows."""

from __future__ import annotations

import contextlib
import os
import random
import re
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import count

import psutil
import pytest
from good_inputs import CONTROLLER_COMMANDS, CONTROLLER_REQUESTS
from hostile_clients import camera_commands, loading, maltreat, with_right_checksum, write_register
from ur_mutants import LINES, RTDE, SCRIPTS
from waiting import eventually

from ronna_hw.control_port import ControlAddress, ask_control_port
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_address, own_udp_endpoint
from ronna_hw.wire.gige_vision import CCP_CONTROL, CCP_OPEN, GVCP_PORT, Bootstrap
from ronna_hw.wire.polaris_rom import MARKER_FACES_OFFSET
from sim.basler.control.feature_table import address_of
from sim.polaris.unit.tool_definition import write_definition
from sim.world.scene.named_scenes import robot_frame

SERVED_IN_S = 15.0  # those before have SILENCE_S each; TCP repeats a refused SYN late
SILENCE_S = 0.5  # after which silent ones give way
WARM_SHARE = 0.3  # of the time; then what is kept is full
GROWTH_LIMIT_BYTES = 24 << 20
MISTAKE = re.compile(r"Traceback|Exception|^\w+: \w+: ")  # the last as the cameras tell of one
HELD = 2  # connections of former malices that stay open
COMMANDS_AT_ONCE = 100
DISCOVERY = bytes.fromhex("4201000200000001")
ROM = write_definition(robot_frame())
FACELESS = with_right_checksum(ROM[:MARKER_FACES_OFFSET] + b"\0" + ROM[MARKER_FACES_OFFSET + 1 :])
TRACKER = (
    b"INIT \r",
    b"VER 4\r",
    b"GET *\r",
    b"\r".join((b"INIT ", *loading(ROM), b"PENA 01D", b"TSTART ", b"BX 1801", b"TX 0001", b"TSTOP ", b"")),
    b"\r".join((b"INIT ", *loading(FACELESS), b"PENA 01D", b"TSTART ", b"BX 1801", b"")),
)
lengths = pytest.mark.parametrize(
    "duration_s", [pytest.param(15.0, marks=pytest.mark.slow), pytest.param(600.0, marks=pytest.mark.soak)]
)
pytestmark = [pytest.mark.timeout(1500), pytest.mark.hazard(34)]


class Simulator(ChildProcess):
    """One that is attacked; `wrong` are its messages about mistakes of ours."""

    def __init__(self, *words: str) -> None:
        self.wrong: list[str] = []
        super().__init__(f"ronna-sim {words[0]}", command("sim.cli", *words), on_message=self._look)

    def _look(self, line: str) -> None:
        if MISTAKE.search(line):
            self.wrong.append(line)


def _last(child: Simulator, turn: Callable[[], str], served: Callable[[], None], duration_s: float) -> None:
    """Malice after malice; after each the simulator serves whoever comes next."""
    process = psutil.Process(child.process.pid)
    seen: Counter[str] = Counter()
    before: tuple[int, int, int] | None = None
    began_s = time.monotonic()
    while (passed_s := time.monotonic() - began_s) < duration_s:
        kind = turn()
        seen[kind] += 1
        asked_s = time.monotonic()
        served()
        took_s = time.monotonic() - asked_s
        assert took_s < SERVED_IN_S, f"after {kind} the next was served in {took_s:.1f} s"
        if before is None and passed_s > WARM_SHARE * duration_s:
            before = _usage(process)
    assert before is not None
    after = _usage(process)
    print(f"{dict(seen)}, bytes, descriptors and threads {before} -> {after}")
    assert after[0] - before[0] < GROWTH_LIMIT_BYTES
    assert after[1] <= before[1] + HELD
    assert after[2] <= before[2] + HELD
    assert not child.wrong


def _usage(process: psutil.Process) -> tuple[int, int, int]:
    return process.memory_info().rss, len(os.listdir(f"/proc/{process.pid}/fd")), process.num_threads()


class StreamClients:
    """Hostile connections to one address; the last ones stay open."""

    def __init__(self, endpoint: str, good: tuple[bytes, ...], seed: int) -> None:
        where = parse_endpoint(endpoint)
        self._address = (where.host, where.port)
        self._good = good
        self._chosen = random.Random(seed)
        self._open: list[socket.socket] = []

    def connect(self) -> socket.socket:
        return socket.create_connection(self._address, timeout=SERVED_IN_S)

    def turn(self) -> str:
        while len(self._open) >= HELD:
            self._open.pop(0).close()
        line = self.connect()
        self._open.append(line)
        return maltreat(line, self._good, self._chosen)

    def close(self) -> None:
        for line in self._open:
            line.close()

    def asked_until(self, request: bytes, answered: Callable[[bytes], bool]) -> None:
        """The next client asks, again on a new connection where it is turned away."""

        def asked() -> bool:
            heard = b""
            with contextlib.suppress(OSError), self.connect() as line:
                line.settimeout(2 * SILENCE_S + 1.0)
                line.sendall(request)
                while more := line.recv(65536):
                    heard += more
                    if answered(heard):
                        return True
            return False

        eventually(asked, 2 * SERVED_IN_S)


@lengths
def test_the_tracker_keeps_serving_despite_hostile_clients(duration_s: float) -> None:
    words = ("polaris", "--endpoint", "tcp://127.0.0.1:0", "--set", f"silent_host_s={SILENCE_S}")
    with Simulator(*words) as child:
        clients = StreamClients(child.ready["endpoint"], TRACKER, seed=1)
        with contextlib.closing(clients):
            _last(
                child,
                clients.turn,
                lambda: clients.asked_until(b"INIT \r", lambda h: b"OKAYA896" in h),
                duration_s,
            )


@pytest.fixture
def controller() -> Iterator[Simulator]:
    free = "tcp://127.0.0.1:0"
    words = ("kuka", "--rsi", own_udp_endpoint(), "--eki", free, "--eki-project", free, "--autostart")
    limit = ("--set", f"first_request_s={SILENCE_S}")
    with Simulator(*words, *limit) as child:
        yield child


@lengths
@pytest.mark.parametrize(
    ("channel", "good", "answer"),
    [
        ("eki_project", CONTROLLER_COMMANDS, b'<State Id="0"'),
        ("eki", CONTROLLER_REQUESTS, b"<Robot>"),
    ],
)
def test_the_command_channels_of_the_arm_keep_serving_despite_hostile_clients(
    controller: Simulator, duration_s: float, channel: str, good: tuple[bytes, ...], answer: bytes
) -> None:
    clients = StreamClients(controller.ready["endpoints"][channel], good, seed=2)

    def turn() -> str:
        kind = clients.turn()
        # A client that has asked for something may stay, as on a real controller: it goes by itself.
        clients.close()
        return kind

    _last(controller, turn, lambda: clients.asked_until(good[0], lambda heard: answer in heard), duration_s)


@lengths
def test_the_arm_controller_keeps_serving_despite_hostile_real_time_replies(
    controller: Simulator, duration_s: float
) -> None:
    chosen = random.Random(3)
    where = parse_endpoint(controller.ready["endpoints"]["rsi"])
    clients = StreamClients(controller.ready["endpoints"]["eki_project"], CONTROLLER_COMMANDS, seed=4)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind((where.host, where.port))
        link.settimeout(SERVED_IN_S)
        good = b'<Sen Type="KROSHU"><AK A1="0.0" A2="0.0" A3="0.0" A4="0.0" A5="0.0" A6="0.0"/><Stop>0</Stop>'

        def turn() -> str:
            for _ in range(COMMANDS_AT_ONCE):
                telegram, sender = link.recvfrom(4096)
                ipoc = telegram.partition(b"<IPOC>")[2].partition(b"<")[0]
                true = good + b"<IPOC>" + ipoc + b"</IPOC></Sen>"
                size = chosen.choice((0, 1, 500, 60_000))
                link.sendto(true, sender)
                link.sendto(chosen.choice((true * 2, true[:-9], b"[" * size, chosen.randbytes(size))), sender)
            return "replies"

        _last(
            controller,
            turn,
            lambda: clients.asked_until(CONTROLLER_COMMANDS[0], lambda heard: b'<State Id="0"' in heard),
            duration_s,
        )


@lengths
@pytest.mark.parametrize(
    ("port", "good"), [("dashboard", LINES), ("primary", SCRIPTS), ("realtime", SCRIPTS), ("rtde", RTDE)]
)
def test_the_universal_robots_controller_keeps_serving_despite_hostile_clients(
    duration_s: float, port: str, good: tuple[bytes, ...]
) -> None:
    with Simulator("ur", "--address", own_address()) as child:
        clients = StreamClients(child.ready["endpoints"][port], good, seed=7)
        others = StreamClients(child.ready["endpoints"]["dashboard"], (), seed=8)
        with contextlib.closing(clients):
            _last(
                child,
                clients.turn,
                lambda: others.asked_until(b"robotmode\n", lambda heard: b"Robotmode: " in heard),
                duration_s,
            )


@lengths
def test_the_cameras_keep_serving_despite_hostile_commands(duration_s: float) -> None:
    with Simulator("basler") as child:
        address = (parse_endpoint(child.ready["endpoints"]["left"]).host, GVCP_PORT)
        chosen, numbers = random.Random(5), count(1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:

            def turn() -> str:
                for datagram in camera_commands(chosen, COMMANDS_AT_ONCE):
                    link.sendto(datagram, address)
                return "commands"

            def served() -> None:
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
                    own.settimeout(1.0)
                    own.connect(address)
                    number = (next(numbers) % 60_000 + 1).to_bytes(2, "big")
                    for _ in range(int(SERVED_IN_S) + 1):
                        own.send(DISCOVERY[:-2] + number)
                        with contextlib.suppress(TimeoutError):
                            while own.recv(65536)[6:8] != number:
                                pass
                            return
                raise AssertionError("no answer to a discovery")

            # From the first picture on, which any malice may happen to ask for, 27 MB of working memory stay.
            _take_a_picture(link, address)
            _last(child, turn, served, duration_s)


def _take_a_picture(link: socket.socket, address: tuple[str, int]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream:
        stream.bind(("", 0))
        stream.settimeout(SERVED_IN_S)
        port = stream.getsockname()[1]
        for register, value in (
            (Bootstrap.CCP, CCP_CONTROL),
            (Bootstrap.SCP, port),
            (address_of("AcquisitionStart"), 1),
        ):
            link.sendto(write_register(register, value), address)
        stream.recv(65536)
        link.sendto(write_register(Bootstrap.CCP, CCP_OPEN), address)


@lengths
def test_the_control_port_keeps_serving_despite_hostile_clients(duration_s: float) -> None:
    with Simulator("polaris") as child:
        control = child.ready["control"]
        address = ControlAddress.parse(control)
        token = b'{"token": "%b"}\n' % address.token.encode()
        good = (
            b'{"do": "clear_faults"}\n',
            token,
            token + b'{"do": "mount", "number": 2}\n',
            b"POST / HTTP/1.1\r\n",
        )
        clients = StreamClients(str(address.endpoint), good, seed=6)
        with contextlib.closing(clients):
            _last(child, clients.turn, lambda: ask_control_port(control, "clear_faults"), duration_s)
