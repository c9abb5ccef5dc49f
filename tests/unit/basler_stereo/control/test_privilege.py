"""Taking control of a camera that another client holds, or held until it died."""

from __future__ import annotations

import time

import pytest

from drivers.basler_stereo.control_channel import take_control
from drivers.basler_stereo.errors import CommandRefused, ControlTaken
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GevStatus


class HeldCamera:
    """A camera that refuses control a number of times; `heartbeat_ms` None: reading is refused too."""

    def __init__(
        self, refusals: int, heartbeat_ms: int | None, status: int = GevStatus.ACCESS_DENIED
    ) -> None:
        self.left, self.heartbeat_ms, self.status = refusals, heartbeat_ms, status
        self.asked = 0

    def write_register(self, address: int, value: int, deadline_s: float) -> None:
        assert (address, value) == (Bootstrap.CCP, gev.CCP_CONTROL)
        assert time.monotonic() < deadline_s
        self.asked += 1
        if self.asked <= self.left:
            raise self._refusal()

    def read_register(self, address: int, deadline_s: float) -> int:
        if address == Bootstrap.CCP:
            return gev.CCP_CONTROL
        assert address == Bootstrap.HEARTBEAT_TIMEOUT_MS
        if self.heartbeat_ms is None:
            raise self._refusal()
        return self.heartbeat_ms

    def _refusal(self) -> CommandRefused:
        error = CommandRefused("refused")
        error.status = self.status
        return error


def taken(camera: HeldCamera, limit_s: float) -> None:
    take_control(camera, "the left camera", time.monotonic() + limit_s)  # type: ignore[arg-type]


@pytest.mark.parametrize("heartbeat_ms", [3000, None])
def test_control_held_by_a_dead_client_is_awaited(heartbeat_ms: int | None) -> None:
    camera = HeldCamera(3, heartbeat_ms)
    taken(camera, 10.0)
    assert camera.asked == 4


def test_a_client_that_outlives_its_heartbeat_keeps_control() -> None:
    camera = HeldCamera(1000, 0)
    with pytest.raises(ControlTaken, match=r"GEV-005.*the left camera"):
        taken(camera, 60.0)  # the test's own time-out is the limit
    assert camera.asked > 1


@pytest.mark.parametrize("heartbeat_ms", [60_000, None])
def test_control_is_awaited_no_longer_than_the_time_limit(heartbeat_ms: int | None) -> None:
    with pytest.raises(ControlTaken, match="GEV-005"):
        taken(HeldCamera(1000, heartbeat_ms), 0.5)


def test_another_refusal_is_not_taken_for_a_second_controller() -> None:
    camera = HeldCamera(1000, 3000, GevStatus.INVALID_ADDRESS)
    with pytest.raises(CommandRefused, match="GEV-006"):
        taken(camera, 10.0)
    assert camera.asked == 1
