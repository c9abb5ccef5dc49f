"""Two small cameras, and stereo drivers that are connected to them."""

from __future__ import annotations

import pytest
from peer_cameras import HANG_LIMIT_S, SERIALS, Peer

from drivers.basler_stereo import BaslerStereoPair
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig


@pytest.fixture
def make_peer():
    made = []

    def make(*arguments: str) -> Peer:
        made.append(Peer(*arguments))
        return made[-1]

    yield make
    for peer in made:
        peer.close()


@pytest.fixture
def peers(make_peer):
    started = [make_peer(serial) for serial in SERIALS]
    return [peer.ready() for peer in started]


@pytest.fixture
def make_pair(peers):
    made = []

    def make(left=None, right=None, **options) -> BaslerStereoPair:
        left, right = left or peers[0], right or peers[1]
        config = DeviceConfig(
            driver="basler_stereo",
            endpoints={"left": f"gev://{left.address}", "right": f"gev://{right.address}"},
            options={"left_serial": SERIALS[0], "right_serial": SERIALS[1], **options},
        )
        made.append(BaslerStereoPair("stereo", config, HostClock()))
        return made[-1]

    yield make
    for device in made:
        device.close()


@pytest.fixture
def pair(make_pair):
    device = make_pair(heartbeat_ms=1000)
    device.connect(HANG_LIMIT_S)
    device.configure(HANG_LIMIT_S)
    device.activate(HANG_LIMIT_S)
    return device
