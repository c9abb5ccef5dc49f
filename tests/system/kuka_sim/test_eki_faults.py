"""Every scripted fault of the EKI channel, and what a client sees of it."""

from __future__ import annotations

import re

import pytest
from kuka_stage import Stage


def test_cutting_eki_ends_the_connection_but_not_the_run(stage: Stage) -> None:
    stage.inject("eki cut")
    stage.rsi.cycles(3)
    with pytest.raises(ConnectionError):
        stage.eki.until(lambda element: False)
    stage.rsi.cycles(20)
    assert stage.reconnect().state(Id="8").get("RSI") == "2"


@pytest.mark.parametrize(("fault", "outside"), [("eki garbage", b"what?"), ("eki padding", b"\0\0")])
def test_garbage_and_padding_are_outside_the_telegrams(stage: Stage, fault: str, outside: bytes) -> None:
    stage.inject(fault)
    stage.rsi.cycles(3)
    (spoilt,) = [segment for segment in stage.eki.raw(4) if outside in segment]
    assert re.search(rb"<State .*</State>", spoilt)  # the telegram itself is whole
    stage.world.set_fault_script("")
    assert stage.reconnect().state(Id="8").get("RSI") == "2"
