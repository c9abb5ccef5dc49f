"""A simulated controller in its own world, connected to the arm driver; and a bare UDP client."""

from __future__ import annotations

import re
import socket
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from benchmarks.robot.turnaround import REPLY_LIMIT_S, Turnarounds
from drivers.kuka_rsi import KukaRsiArm
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_udp_endpoint
from ronna_hw.wire.kuka_context import OWN_CONTEXT
from sim.world.process import load_scene
from sim.world.world import World

PEERS = Path(__file__).parents[1] / "peers"
SILENCE_LIMIT_S = 5.0  # lock-step waits up to 2 s for a reply


def peer(name: str, *arguments: str) -> ChildProcess:
    """Start a peer process and wait for its READY line."""
    return ChildProcess(name, [sys.executable, "-P", str(PEERS / f"{name}.py"), *arguments])


class RobotCell:
    """`ronna-sim kuka` in lock-step with an active arm driver."""

    def __init__(self) -> None:
        self._ending = ExitStack()
        self.world = World.create(load_scene("bench"), paced=False)
        free = "tcp://127.0.0.1:0"
        more = ["--world", self.world.endpoint, "--rsi", own_udp_endpoint()]
        more += ["--rsi-context", str(OWN_CONTEXT)]
        arguments = command("sim.cli", "kuka", *more, "--eki", free, "--eki-project", free)
        self.controller = self._ending.enter_context(ChildProcess("ronna-sim kuka", arguments))
        ready = self.controller.ready["endpoints"]
        config = DeviceConfig(
            driver="kuka_rsi",
            endpoints={"rsi": ready["rsi"], "eki_project": ready["eki_project"]},
            options={"silence_limit_s": SILENCE_LIMIT_S},
        )
        self.arm = KukaRsiArm("robot.master", config, open_clock(self.world.clock_endpoint))
        self._ending.callback(self.arm.close)

    def __enter__(self) -> Self:
        try:
            self.arm.connect()
            self.arm.configure()
            self.arm.activate()
        except BaseException:  # including interruptions: no controller is left running
            self._ending.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.close()


START_DEG = (0.0, -90.0, 90.0, 0.0, 60.0, 0.0)
FIRST_IPOC = 1_000_000
CYCLE_MS = 4
LONGEST = 8192
CORRECTIONS = re.compile(
    rb'A1="([^"]+)" A2="([^"]+)" A3="([^"]+)" A4="([^"]+)" A5="([^"]+)" A6="([^"]+)"\s*/>.*<IPOC>(\d+)</IPOC>'
)
TELEGRAM = (
    '<Rob Type="KUKA"><RIst X="445.0000" Y="0.0000" Z="810.0000" A="180.0000" B="0.0000" C="180.0000"/>'
    '<AIPos A1="%.4f" A2="%.4f" A3="%.4f" A4="%.4f" A5="%.4f" A6="%.4f"/>'
    '<EIPos E1="0.0000" E2="0.0000" E3="0.0000" E4="0.0000" E5="0.0000" E6="0.0000"/>'
    '<Delay D="0"/><MACur A1="0.0000" A2="-31.2500" A3="12.0000" A4="0.0000" A5="-4.5000" A6="0.0000"/>'
    "<IPOC>%d</IPOC></Rob>"
)


def bare_telegram() -> bytes:
    return (TELEGRAM % (*START_DEG, FIRST_IPOC)).encode("ascii")


class ControllerProbe(Turnarounds):
    """Stand-in for a controller, connected to a `udp://` endpoint on this machine."""

    def __init__(self, endpoint: str) -> None:
        super().__init__()
        self._link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        client = parse_endpoint(endpoint)
        self._link.connect((client.host, client.port))
        self._link.settimeout(REPLY_LIMIT_S)
        self._ipoc = FIRST_IPOC
        self._axes_deg = START_DEG
        self.moved_deg = 0.0  # travel of A1 so far: shows that a moving client really moves

    def exchange(self, telegram: bytes) -> bytes:
        """Send a telegram and return the next reply; raises TimeoutError."""
        self._link.send(telegram)
        return self._link.recv(LONGEST)

    def next_message(self) -> bytes:
        self._ipoc += CYCLE_MS
        return (TELEGRAM % (*self._axes_deg, self._ipoc)).encode("ascii")

    def ask(self, message: bytes) -> bytes | None:
        self._link.send(message)
        mark = b"<IPOC>%d</IPOC>" % self._ipoc
        while True:
            try:
                reply = self._link.recv(LONGEST)
            except OSError:
                return None
            if mark in reply:
                return reply

    def follow(self, reply: bytes) -> None:
        if reply.startswith(b"<Rob"):
            return  # an echo
        found = CORRECTIONS.search(reply)
        if found is None:
            return
        a, b, c, d, e, f = (
            start + float(value) for start, value in zip(START_DEG, found.groups()[:6], strict=True)
        )
        self.moved_deg += abs(a - self._axes_deg[0])
        self._axes_deg = (a, b, c, d, e, f)

    def close(self) -> None:
        self._link.close()
