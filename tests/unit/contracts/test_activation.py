import signal
from collections.abc import Callable

import pytest
from ideal_device import IdealDevice

from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.errors import DeviceError, LinkTimeout


class Recorded(IdealDevice):
    """Writes down the calls of its lifecycle; `on_deactivate` happens on leaving."""

    def __init__(self) -> None:
        super().__init__("device", DeviceConfig(driver="test", endpoint="host:"), HostClock(), known=set())
        self.calls: list[str] = []
        self.on_deactivate: Callable[[], None] = lambda: None

    def connect(self, timeout_s: float = 10.0) -> Identity:
        self.calls.append("connect")
        self.guard.enter(Lifecycle.CONNECTED)
        return Identity("Test", "Ideal", "1", "0")

    def configure(self, timeout_s: float = 10.0) -> None:
        self.calls.append("configure")
        super().configure(timeout_s)

    def activate(self, timeout_s: float = 10.0) -> None:
        self.calls.append("activate")
        super().activate(timeout_s)

    def deactivate(self, timeout_s: float = 10.0) -> None:
        self.on_deactivate()
        self.calls.append("deactivate")
        self.guard.enter(Lifecycle.CONFIGURED)


@pytest.fixture
def device() -> Recorded:
    return Recorded()


def test_a_device_is_brought_to_active_from_disconnected_and_from_configured(device: Recorded) -> None:
    with device.active() as active:
        assert active is device
        assert device.state is Lifecycle.ACTIVE
    with device.active():
        pass
    assert device.calls == ["connect", "configure", *2 * ("activate", "deactivate")]


def test_a_nested_block_leaves_the_device_active(device: Recorded) -> None:
    with device.active():
        with device.active():
            pass
        assert device.state is Lifecycle.ACTIVE
    assert device.calls == ["connect", "configure", "activate", "deactivate"]


def test_a_device_in_hold_is_deactivated_and_activated_again(device: Recorded) -> None:
    with device.active():
        device.guard.enter(Lifecycle.HOLD)
        with device.active():
            assert device.state is Lifecycle.ACTIVE
    assert device.calls[2:] == ["activate", "deactivate", "activate", "deactivate"]


def test_a_failure_to_deactivate_does_not_mask_an_error_and_is_raised_when_there_is_none(
    device: Recorded,
) -> None:
    def refuse() -> None:
        raise LinkTimeout("no reply to STOP")

    device.on_deactivate = refuse
    with pytest.raises(ZeroDivisionError) as caught, device.active():
        raise ZeroDivisionError
    assert caught.value.__notes__ == ["device could not be deactivated: no reply to STOP"]
    device.guard.enter(Lifecycle.CONFIGURED)
    with pytest.raises(LinkTimeout), device.active():
        pass


def test_a_second_interrupt_waits_until_the_device_is_inactive(device: Recorded) -> None:
    device.on_deactivate = lambda: signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), device.active():
        raise KeyboardInterrupt
    assert device.state is Lifecycle.CONFIGURED


def test_a_fault_in_the_block_stays_latched_and_the_next_block_is_refused(device: Recorded) -> None:
    fault = DeviceError("hardware failure")
    with device.active():
        device.guard.latch(fault)
    assert device.calls[-1] == "activate"
    assert device.observe().fault is fault
    with pytest.raises(WrongState, match=r"got fault \(hardware failure"), device.active():
        pass


@pytest.mark.parametrize("state", list(Lifecycle))
def test_a_device_can_be_observed_in_every_state(device: Recorded, state: Lifecycle) -> None:
    device.guard._now = (state, None)
    assert device.observe().state is state
