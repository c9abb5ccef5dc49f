"""Network interfaces have names, addresses, subnets and sizes."""

from __future__ import annotations

from ronna_hw.host.network import find_interface, interfaces


def test_the_loopback_interface_is_found_and_reaches_only_addresses_of_its_subnet() -> None:
    own = find_interface("127.0.0.1")
    assert own in interfaces()
    assert own is not None
    assert own.loopback
    assert own.mtu_bytes > 1500
    assert own.reaches("127.9.9.9")
    assert not own.reaches("192.168.3.1")
    assert not own.reaches("camera.local")
