"""Load of a tool, as the controller takes it and gives it back."""

from __future__ import annotations

from coded_errors import raises

from drivers.universal_robots.errors import BAD_LOAD
from drivers.universal_robots.loads import has_load, load_commands, to_load
from ronna_hw.devices.contact import ToolLoad


def test_a_load_is_set_in_metres_and_compared_when_read_back() -> None:
    load = ToolLoad(1.2, (0.0, 1.0, 60.0), (0.0, 0.0, 150.0))
    assert load_commands(load) == ("set_payload(1.2, [0, 0.001, 0.06])", "set_tcp(p[0, 0, 0.15, 0, 0, 0])")
    read = to_load((1.2, 0.0, 0.001, 0.06, 0.0, 0.0, 0.15, 0.0, 0.0, 0.0))
    assert has_load(read, load, None)
    assert not has_load(ToolLoad(1.2, load.centre_mm), load, None)
    with raises(BAD_LOAD):
        load_commands(ToolLoad(5.5))
