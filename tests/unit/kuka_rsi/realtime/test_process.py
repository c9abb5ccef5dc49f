"""The real-time process imports little, survives mutants, and outlives its parent until the arm stops."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from driven_arm import activated
from mutations import mutations
from rsi_loop import CYCLE_MS, FIRST_IPOC, START_DEG, InProcessLink, answer_mutants, corrections_of, telegram
from rsi_stand import LIMITS

from drivers.kuka_rsi.arm import KukaRsiArm
from drivers.kuka_rsi.connections import link_settings, start_link
from drivers.kuka_rsi.options import KukaOptions
from ronna_hw.arm_stream import loop as link_loop
from ronna_hw.arm_stream.client import LinkClient
from ronna_hw.arm_stream.records import CloseStream, OpenStream, StreamPhase
from ronna_hw.devices.robot import JointMove
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.network import own_udp_endpoint
from ronna_hw.wire.kuka_context import load_context

MS = 1_000_000  # ns


@pytest.mark.hazard(30)
def test_a_controller_delayed_by_less_than_its_timeout_is_still_sent_the_stop(
    link: InProcessLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    def done_after(quiet_ms: int) -> bool:
        now_ns = link.now_ns + quiet_ms * MS
        monkeypatch.setattr(
            link_loop, "time", SimpleNamespace(monotonic_ns=lambda: now_ns, sleep=lambda _: 0)
        )
        return link.loop._is_done()

    def reply(cycle: int) -> bytes:
        data = link.receive(telegram(FIRST_IPOC + cycle * CYCLE_MS))
        assert data is not None
        return data

    assert b"<Stop>0</Stop>" in reply(0)
    assert not done_after(10_000)  # its parent is there
    link.loop.session.is_parent_gone = True
    assert not done_after(390)
    assert done_after(410)
    cycle = 1
    while b"<Stop>1</Stop>" not in reply(cycle):
        assert not done_after(390)
        cycle += 1
    assert cycle < 10  # the arm is at rest
    assert not done_after(90)
    assert done_after(110)


HEAVY = {"numpy", "scipy", "pydantic", "cv2", "structlog", "pinocchio", "pydicom", "typer"}


def test_a_running_link_imports_no_heavy_package(
    make_arm: Callable[..., KukaRsiArm], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPROFILEIMPORTTIME", "1")  # the process lists each import on standard error
    arm = activated(make_arm())
    start = arm.read_state().joints_rad
    arm.move(JointMove((start[0] + 0.01, *start[1:])))
    stream = arm.connections.link.process.stderr
    assert stream is not None
    with os.fdopen(os.dup(stream.fileno()), encoding="utf-8") as messages:
        arm.close()
        imported = {line.rsplit("|", 1)[-1].strip() for line in messages if line.startswith("import time:")}
    assert "drivers.kuka_rsi.realtime.loop" in imported
    assert not HEAVY & {name.split(".")[0] for name in imported}


SOAK = (pytest.mark.soak, pytest.mark.timeout(3600))
OVER_THE_SOCKET = 2_000
FRESH_EVERY = 200  # mutants over the socket: some of them end a session, as telegrams of another run
GENEROUS_S = 30.0


@pytest.mark.parametrize(
    ("count", "seed"),
    [(3_000, 1), *(pytest.param(10_000, seed, marks=SOAK) for seed in range(300, 310))],
)
def test_mutants_in_a_session_cause_no_motion(count: int, seed: int) -> None:
    answered, refused = answer_mutants(count, seed)
    assert answered > count / 100  # some are still telegrams
    assert refused > count / 3


def test_mutants_over_the_socket_cause_no_crash_and_no_motion() -> None:
    endpoint = parse_endpoint(own_udp_endpoint())
    options = KukaOptions(silence_limit_s=60.0, heartbeat_limit_s=60.0, real_time_priority=0)
    link = start_link(link_settings(endpoint, load_context(), options))
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
            controller.connect((endpoint.host, endpoint.port))
            controller.settimeout(GENEROUS_S)
            ipoc = FIRST_IPOC
            for number, mutant in enumerate(mutations([telegram(0)], OVER_THE_SOCKET, seed=2)):
                if number % FRESH_EVERY == 0:
                    ipoc += CYCLE_MS
                    _answered(controller, link, ipoc)
                controller.send(mutant)
            _answered(controller, link, ipoc + CYCLE_MS)
            assert link.alive
            assert not link.state.moving
    finally:
        link.close()


def _answered(controller: socket.socket, link: LinkClient, ipoc: int) -> None:
    """Test whether a fresh session answers a telegram, whatever came before."""
    link.command(CloseStream())
    link.wait(lambda s: s.phase is StreamPhase.IDLE, GENEROUS_S)
    number = link.command(OpenStream(LIMITS))
    link.wait(lambda s: s.command_number >= number, GENEROUS_S)
    deadline = time.monotonic() + GENEROUS_S
    while time.monotonic() < deadline:
        controller.send(telegram(ipoc, START_DEG))
        reply = controller.recv(4096)
        assert corrections_of(reply) == (0.0,) * 6
        if b"<IPOC>%d</IPOC>" % ipoc in reply:
            return
    raise AssertionError("no reply")
