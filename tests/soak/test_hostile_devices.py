"""A malicious device: the driver reports a code in time, and nothing grows."""

from __future__ import annotations

import contextlib
import gc
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import psutil
import pytest
from faulty_cameras import AREA
from hostile_devices import (
    HostileCamera,
    HostileLine,
    HostileSerialLine,
    HostileTelegrams,
    free_camera_addresses,
    with_right_crcs,
)
from waiting import eventually

from drivers.basler_stereo import BaslerStereoPair
from drivers.kuka_rsi import KukaRsiArm
from drivers.ndi_polaris import PolarisTracker
from ronna_hw.arm_stream.arm import CLOSING_STOP_S
from ronna_hw.arm_stream.client import END_TIMEOUT_S
from ronna_hw.arm_stream.control_channel import CLOSE_TIMEOUT_S
from ronna_hw.arm_stream.motion import STOP_S
from ronna_hw.clock import HostClock, open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.robot import JointMove
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import RonnaError, StateError
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_udp_endpoint
from sim.polaris.unit.model import SPECTRA
from sim.world.process import load_scene
from sim.world.world import World

LIMIT_S = 3.0  # given to each call
RECOVERS_IN_S = 10.0  # as the drivers' own default
STALLS_S = 2.0  # of these machines, while other programs work
OF_ONE_DEVICE = 3  # sessions; then there is a new one
TRACKER_CLOSES_IN_S = STEREO_CLOSES_IN_S = 3.0  # as their `close` states
# The arm comes to rest, its motion and its program end; then the channel and the process.
ARM_CLOSES_IN_S = 3 * CLOSING_STOP_S + CLOSE_TIMEOUT_S + END_TIMEOUT_S
WIDEST_GAPS = 3.0  # of multiples of the golden section, in shares of equal ones: less
LOST_SHARE = 0.25  # of sessions in which cameras are lost once they are active
WARM_SHARE = 0.3  # of the time; then what is kept is full
GROWTH_LIMIT_BYTES = 24 << 20
BEHIND_THE_TAP = 1
lengths = pytest.mark.parametrize(
    "duration_s", [pytest.param(25.0, marks=pytest.mark.slow), pytest.param(600.0, marks=pytest.mark.soak)]
)
pytestmark = [pytest.mark.timeout(1500), pytest.mark.hazard(16)]


@dataclass
class Stand:
    """One driver before its hostile device. Each session is `calls` in turn, to the first error.

    The next session recovers the same device, where it is not yet time for a new one, and where its malice
    lets it. When a device has relented the driver recovers. A call may take its limit and `overtime_s`, which
    the driver states.
    """

    make: Callable[[], Any]
    calls: Callable[[Any], list[Callable[[], Any]]]
    turn: Callable[[], str]  # another malice; tells which
    relent: Callable[[], None]  # the end of all malice
    closes_in_s: float
    overtime_s: float = 0.0
    ended: Callable[[], None] = lambda: None  # after each session
    codes: Counter[str] = field(default_factory=Counter)
    recovered: Counter[tuple[str, bool]] = field(default_factory=Counter)
    sessions: int = 0

    def sessions_of_one_device(self) -> None:
        device = self.make()
        malice = ""
        try:
            for _ in range(OF_ONE_DEVICE):
                malice = self.turn()
                self.session(device, malice)
                self.ended()
            self.relent()
            if device.state is Lifecycle.FAULT:
                device.recover("tester", RECOVERS_IN_S)
                self.recovered["relented", True] += 1
        finally:
            with at_most(self.closes_in_s + STALLS_S, f"{malice}: close"):
                device.close()
        self.ended()

    def session(self, device: Any, malice: str) -> None:
        self.sessions += 1
        if device.state is Lifecycle.FAULT:
            recovered = self.whole(lambda: device.recover("tester", LIMIT_S), malice)
            self.recovered[malice.partition(" from")[0], recovered] += 1
        for call in self.calls(device):
            if not self.whole(call, malice):
                return
        self.codes["none"] += 1

    def whole(self, call: Callable[[], Any], malice: str) -> bool:
        """Whether a call succeeded, or was none of this state: of a device that is connected already."""
        try:
            with at_most(LIMIT_S + self.overtime_s + STALLS_S, f"{malice}: {call}"):
                call()
        except WrongState:
            return True
        except RonnaError as error:
            self.codes[error.code] += 1  # an error without one is counted below
            return False
        return True

    def last(self, duration_s: float) -> None:
        began_s = time.monotonic()
        before: Usage | None = None
        while (passed_s := time.monotonic() - began_s) < duration_s:
            self.sessions_of_one_device()
            if before is None and passed_s > WARM_SHARE * duration_s:
                before = Usage.now()
        assert before is not None
        after = Usage.now()
        print(f"{self.sessions} sessions, {dict(self.codes)}, recovered {dict(self.recovered)}")
        print(f"{before} -> {after}")
        assert after.descriptors <= before.descriptors
        assert after.threads <= before.threads
        assert after.children <= before.children
        assert after.resident_bytes - before.resident_bytes < GROWTH_LIMIT_BYTES
        assert len(self.codes) > 1
        assert self.recovered
        assert "" not in self.codes


@dataclass(frozen=True)
class Usage:
    """Of this process."""

    resident_bytes: int
    descriptors: int
    threads: int
    children: int

    @classmethod
    def now(cls) -> Usage:
        gc.collect()
        own = psutil.Process()
        return cls(
            own.memory_info().rss,
            len(os.listdir("/proc/self/fd")),
            threading.active_count(),
            len(own.children(recursive=True)),
        )


@contextlib.contextmanager
def at_most(limit_s: float, what: str) -> Iterator[None]:
    began_s = time.monotonic()
    try:
        yield
    finally:
        took_s = time.monotonic() - began_s
        assert took_s < limit_s, f"{what} took {took_s:.1f} s"


def assert_spread(resets: list[float]) -> None:
    """Connections were reset in all parts of a conversation: the widest gap is of the order of its share."""
    ends = sorted((0.0, *resets, 1.0))
    widest = max(later - sooner for sooner, later in pairwise(ends))
    assert widest <= WIDEST_GAPS / max(len(resets), 1), resets


@lengths
@pytest.mark.parametrize("kind", [HostileLine, HostileSerialLine])
def test_the_tracker_driver_withstands_a_hostile_unit(kind: type[HostileLine], duration_s: float) -> None:
    with ExitStack() as stack:
        words = command("sim.cli", "polaris", "--endpoint", "tcp://127.0.0.1:0")
        unit = stack.enter_context(ChildProcess("ronna-sim polaris", words))
        line = stack.enter_context(kind(parse_endpoint(unit.ready["endpoint"]), 1, with_right_crcs))

        def turn() -> str:
            line.silence(False)
            return line.choose()

        def make() -> PolarisTracker:
            tools = [{"name": "robot_frame", "rom": "robot_frame.rom"}]
            # Without a serial number, one that lies at first would be what the true unit is compared with.
            options = {"tools": tools, "expected_serial": SPECTRA.serial_number}
            config = DeviceConfig(driver="ndi_polaris", endpoint=line.endpoint, options=options)
            return PolarisTracker("tracker", config, HostClock())

        def calls(tracker: PolarisTracker) -> list[Callable[[], Any]]:
            return [
                lambda: tracker.connect(LIMIT_S),
                lambda: tracker.configure(LIMIT_S),
                lambda: tracker.activate(LIMIT_S),
                *[tracker.read_frame] * 20,
                lambda: tracker.deactivate(LIMIT_S),
            ]

        Stand(make, calls, turn, line.relent, TRACKER_CLOSES_IN_S).last(duration_s)
        assert_spread(line.resets)


@pytest.fixture
def controller() -> Iterator[tuple[World, dict[str, str]]]:
    world = World.create(load_scene("bench"), paced=False)
    free = "tcp://127.0.0.1:0"
    options = (
        "--rsi",
        own_udp_endpoint(),
        "--eki",
        free,
        "--eki-project",
        free,
        "--set",
        "first_request_s=1",
    )
    words = command("sim.cli", "kuka", "--world", world.endpoint, *options)
    with ChildProcess("ronna-sim kuka", words) as child:
        yield world, child.ready["endpoints"]


def _arm(world: World, rsi: str, eki: str) -> KukaRsiArm:
    endpoints = {"rsi": rsi, "eki_project": eki}
    config = DeviceConfig(driver="kuka_rsi", endpoints=endpoints)
    return KukaRsiArm("robot.master", config, open_clock(world.clock_endpoint))


def _arm_calls(arm: KukaRsiArm) -> list[Callable[[], Any]]:
    def move() -> None:
        A1, A2, A3, A4, A5, A6 = arm.read_state(LIMIT_S).joints_rad
        arm.move(JointMove((A1 + (0.05 if A1 < 0.0 else -0.05), A2, A3, A4, A5, A6)), timeout_s=LIMIT_S)

    def acknowledge() -> None:
        with contextlib.suppress(StateError):  # the session before left no message
            arm.recover("tester", LIMIT_S)

    return [
        lambda: arm.connect(LIMIT_S),
        acknowledge,
        lambda: arm.configure(LIMIT_S),
        lambda: arm.activate(LIMIT_S),
        move,
        move,
        lambda: arm.deactivate(LIMIT_S),
    ]


@lengths
def test_the_arm_driver_withstands_a_hostile_command_channel(
    controller: tuple[World, dict[str, str]], duration_s: float
) -> None:
    world, endpoints = controller
    with HostileLine(parse_endpoint(endpoints["eki_project"]), seed=2) as line:

        def turn() -> str:
            line.silence(False)
            return line.choose()

        def rests() -> None:
            eventually(lambda: world.arm().at_rest)

        make = lambda: _arm(world, endpoints["rsi"], line.endpoint)  # noqa: E731
        Stand(make, _arm_calls, turn, line.relent, ARM_CLOSES_IN_S, STOP_S, rests).last(duration_s)
        assert_spread(line.resets)


@lengths
def test_the_arm_driver_withstands_a_hostile_real_time_link(
    controller: tuple[World, dict[str, str]], duration_s: float
) -> None:
    world, endpoints = controller
    behind = own_udp_endpoint(BEHIND_THE_TAP)
    tap = HostileTelegrams(parse_endpoint(endpoints["rsi"]), parse_endpoint(behind), seed=3)
    with tap:
        shares = (0.0, 0.001, 0.02, 0.5)

        def turn() -> str:
            tap.share = tap._chosen.choice(shares)
            return f"{tap.share:.1%} of the telegrams"

        def relent() -> None:
            tap.share = 0.0

        def rests() -> None:
            relent()
            eventually(lambda: world.arm().at_rest)

        make = lambda: _arm(world, behind, endpoints["eki_project"])  # noqa: E731
        Stand(make, _arm_calls, turn, relent, ARM_CLOSES_IN_S, STOP_S, rests).last(duration_s)


@lengths
def test_the_stereo_driver_withstands_hostile_cameras(duration_s: float) -> None:
    with ExitStack() as stack:
        child = stack.enter_context(ChildProcess("ronna-sim basler", command("sim.cli", "basler")))
        true = [child.ready["endpoints"][side].removeprefix("gev://") for side in ("left", "right")]
        ours = free_camera_addresses()
        cameras = [HostileCamera(*pair, seed=seed) for seed, pair in enumerate(zip(true, ours, strict=True))]
        for camera in cameras:
            stack.callback(camera.close)
        draw = cameras[0]._chosen

        def turn() -> str:
            share = draw.choice((0.0, 0.002, 0.02, 0.3))
            for camera in cameras:
                camera.share = share
            return f"{share:.1%} of the datagrams"

        def worsen() -> None:
            """From here on nothing usable comes in some sessions: those end in a fault."""
            if draw.random() < LOST_SHARE:
                for camera in cameras:
                    camera.share = 1.0

        def relent() -> None:
            for camera in cameras:
                camera.share = 0.0

        def make() -> BaslerStereoPair:
            sides = zip(("left", "right"), ours, strict=True)
            endpoints = {side: f"gev://{address}" for side, address in sides}
            config = DeviceConfig(driver="basler_stereo", endpoints=endpoints)
            return BaslerStereoPair("stereo", config, HostClock())

        def calls(pair: BaslerStereoPair) -> list[Callable[[], Any]]:
            return [
                lambda: pair.connect(LIMIT_S),
                lambda: pair.configure(LIMIT_S),
                lambda: pair.set_areas(AREA, AREA, LIMIT_S),
                lambda: pair.activate(LIMIT_S),
                worsen,
                *[lambda: pair.grab_pair(LIMIT_S)] * 5,
                lambda: pair.deactivate(LIMIT_S),
            ]

        Stand(make, calls, turn, relent, STEREO_CLOSES_IN_S).last(duration_s)
