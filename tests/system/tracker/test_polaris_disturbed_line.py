"""The driver on a TCP line that disturbs the simulator's replies, within short time limits."""

from __future__ import annotations

import math
import random
import struct
import time

import pytest
from polaris_mutations import COMMANDS_TO_RECOVER, MUTATIONS, Delivery, whole_binary

from conformance.disturbed_line import DisturbedLine
from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.errors import LinkLost
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.host.child_process import ChildProcess, command

LIMIT_S = 0.3  # of the commands in tracking; the unit's own are 2 to 4 s
LONGEST_DELAY_S = 2 * LIMIT_S
HANG_S = 60.0  # one reading or recovery, on a busy computer
NEAR_MM = 3.0
TOOL = "robot_frame"


class MutatingLine(DisturbedLine):
    """Disturbs the next replies by the kinds of the million; keeps what the driver was sent."""

    def __init__(self, unit: ChildProcess, seed: int) -> None:
        super().__init__(parse_endpoint(unit.ready["endpoint"]))
        self.left = 0
        self.mutated = 0
        self.quiet_from_s = 0.0
        self.sent = b""
        self.breaks_after: int | None = None  # bytes of the next reply
        self._chosen = random.Random(seed)

    def _disturb(self, data: bytes) -> Delivery:
        deliveries: Delivery = [(0.0, data)]
        if self.breaks_after is not None:
            deliveries = [(0.0, data[: self.breaks_after])]
            self.breaks_after = None
            self.cut()
        elif self.left:
            self.left -= 1
            self.mutated += 1
            shorter = LONGEST_DELAY_S / 6.0  # the million's delays are up to six seconds
            mutation = self._chosen.choice(MUTATIONS)
            deliveries = [(delay_s * shorter, part) for delay_s, part in mutation(data, self._chosen)]
        for delay_s, part in deliveries:
            self.quiet_from_s = max(self.quiet_from_s, time.monotonic() + delay_s)
            self.sent += part
        return deliveries


def run(replies: int, seed: int) -> None:
    arguments = command("sim.cli", "polaris", "--endpoint", "tcp://127.0.0.1:0")
    with ChildProcess("ronna-sim polaris", arguments) as unit, MutatingLine(unit, seed) as line:
        device = tracker_at(line.endpoint)
        place_mm = device.read_frame().tool(TOOL).position_mm
        assert place_mm is not None
        chosen = random.Random(seed)
        while line.mutated < replies:
            line.left = chosen.randint(1, 3)
            while line.left and device.state is Lifecycle.ACTIVE:
                read(device, line, place_mm)
            line.left = 0
            time.sleep(max(0.0, line.quiet_from_s - time.monotonic()) + 0.01)  # late replies have come
            recover(device, line, place_mm)
        device.close()
        assert device.state is Lifecycle.CLOSED


def tracker_at(endpoint: str) -> PolarisTracker:
    config = DeviceConfig(
        driver="ndi_polaris",
        endpoint=endpoint,
        options={
            "tools": [{"name": TOOL, "rom": "robot_frame.rom"}],
            "reply": "BX",
            "time_limits_s": dict.fromkeys(("BX", "TX", "ECHO"), LIMIT_S),
        },
    )
    device = PolarisTracker("tracker", config, HostClock())
    device.connect()
    device.configure()
    device.activate()
    return device


def read(device: PolarisTracker, line: MutatingLine, place_mm: tuple[float, float, float]) -> bool:
    line.sent = line.sent[-200:]
    began_s = time.monotonic()
    try:
        frame = device.read_frame()
    except RonnaError:
        return False
    finally:
        assert time.monotonic() - began_s < HANG_S
    check(frame, line.sent, place_mm)
    return True


def check(frame: TrackerFrame, sent: bytes, place_mm: tuple[float, float, float]) -> None:
    number = struct.pack("<I", frame.stamp.device_clock)
    assert any(number in body for body in whole_binary(sent)), "a reading was made from a wrong CRC"
    position_mm = frame.tool(TOOL).position_mm
    assert position_mm is not None
    assert math.dist(position_mm, place_mm) < NEAR_MM


def recover(device: PolarisTracker, line: MutatingLine, place_mm: tuple[float, float, float]) -> None:
    for _ in range(COMMANDS_TO_RECOVER):
        if device.state is Lifecycle.FAULT:
            device.recover("tester", timeout_s=HANG_S)
            device.activate()
        if read(device, line, place_mm):
            return
    raise AssertionError(f"not back within {COMMANDS_TO_RECOVER} commands")


@pytest.mark.hazard(4)
def test_a_connection_that_breaks_in_the_middle_of_a_reply_is_lost_and_can_be_recovered() -> None:
    arguments = command("sim.cli", "polaris", "--endpoint", "tcp://127.0.0.1:0")
    with ChildProcess("ronna-sim polaris", arguments) as unit, MutatingLine(unit, 0) as line:
        device = tracker_at(line.endpoint)
        for length in (0, 3, 6, 30):
            device.read_frame()
            line.breaks_after = length
            with pytest.raises(LinkLost, match=r"NDI-008.*(closed at the other end|broke).*recover"):
                device.read_frame()
            assert device.state is Lifecycle.FAULT
            device.recover("tester", timeout_s=HANG_S)
            device.activate()
            assert device.read_frame().tool(TOOL).position_mm is not None
        device.close()


@pytest.mark.hazard(16)
def test_disturbed_replies_over_tcp_are_not_accepted_and_two_commands_recover() -> None:
    run(replies=12, seed=1)


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", [2, 3, 4, 5])
def test_two_thousand_disturbed_replies_over_tcp_are_not_accepted(seed: int) -> None:
    run(replies=500, seed=seed)
