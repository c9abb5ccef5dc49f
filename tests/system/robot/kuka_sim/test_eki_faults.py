"""Every scripted fault of the EKI channel, and what a client sees of it."""

from __future__ import annotations

import re

import pytest
from shared_controller import SharedController


def test_cutting_eki_ends_the_connection_but_not_the_run(shared: SharedController) -> None:
    shared.inject("eki cut")
    shared.rsi.cycles(3)
    with pytest.raises(ConnectionError):
        shared.eki.until(lambda element: False)
    shared.rsi.cycles(20)
    assert shared.reconnect().state(Id="8").get("RSI") == "2"


@pytest.mark.parametrize(("fault", "outside"), [("eki garbage", b"what?"), ("eki padding", b"\0\0")])
def test_garbage_and_padding_are_outside_the_telegrams(
    shared: SharedController, fault: str, outside: bytes
) -> None:
    shared.inject(fault)
    shared.rsi.cycles(3)
    (spoilt,) = [segment for segment in shared.eki.raw(4) if outside in segment]
    assert re.search(rb"<State .*</State>", spoilt)  # the telegram itself is whole
    shared.world.set_fault_script("")
    assert shared.reconnect().state(Id="8").get("RSI") == "2"
