"""Driver's arm with a small controller of the tests' own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from driven_arm import activated
from fake_controller import FakeController

from drivers.kuka_rsi.arm import KukaRsiArm
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.network import own_udp_endpoint

PATIENT = {"silence_limit_s": 1.0, "heartbeat_limit_s": 5.0}  # these machines stall for tens of milliseconds


@pytest.fixture
def controller() -> Iterator[FakeController]:
    fake = FakeController()
    endpoint = parse_endpoint(own_udp_endpoint())
    fake.rsi_address = (endpoint.host, endpoint.port)
    yield fake
    fake.close()


MakeArm = Callable[..., KukaRsiArm]


@pytest.fixture
def make_arm(controller: FakeController) -> Iterator[MakeArm]:
    """Make arms for the fake controller, closed at the end; patient, as these machines stall."""
    made: list[KukaRsiArm] = []

    def make(eki_port: int | None = None, **options: Any) -> KukaRsiArm:
        config = DeviceConfig(
            driver="kuka_rsi",
            endpoints={
                "rsi": own_udp_endpoint(),
                "eki_project": f"tcp://127.0.0.1:{eki_port or controller.eki_port}",
            },
            options={**PATIENT, **options},
        )
        arm = KukaRsiArm("robot.master", config, HostClock())
        made.append(arm)
        return arm

    yield make
    for arm in made:
        arm.close()


@pytest.fixture
def active_arm(make_arm: MakeArm) -> KukaRsiArm:
    return activated(make_arm())
