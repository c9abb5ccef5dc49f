"""Every fault of the EKI channel, by script, and what a client sees of it."""

from __future__ import annotations

import re

import pytest
from kuka_stage import Stage


def test_a_cut_of_eki_ends_the_conversation_and_not_the_run(stage: Stage) -> None:
    stage.inject("eki cut")
    stage.rsi.cycles(3)
    with pytest.raises(ConnectionError):
        stage.eki.until(lambda element: False)
    stage.rsi.cycles(20)
    assert stage.reconnect().state(Id="8").get("RSI") == "2"


def test_a_full_memory_ends_the_connection_with_the_next_request(stage: Stage) -> None:
    assert stage.eki.command("SET_OV", Val=100) == 0  # nothing asked before is still under way
    stage.inject("eki overflow")
    stage.rsi.cycles(30)
    assert stage.eki.read().tag == "State"  # it still tells its state
    stage.eki.socket.sendall(b'<Cmd Id="5" Name="SET_OV" Val="42"></Cmd>')
    with pytest.raises(ConnectionError):
        stage.eki.until(lambda element: False)
    assert stage.reconnect().state(Id="8").get("Ov") == "100"


def test_half_a_telegram_is_followed_by_whole_ones(stage: Stage) -> None:
    stage.inject("eki half telegram")
    stage.rsi.cycles(3)
    segments = stage.eki.raw(4)
    assert any(not text.rstrip().endswith(b"</State>") for text in segments)
    stage.world.set_fault_script("")
    assert stage.reconnect().state(Id="8").get("RSI") == "2"


@pytest.mark.parametrize(("fault", "outside"), [("eki garbage", b"what?"), ("eki padding", b"\0\0")])
def test_garbage_and_padding_stand_outside_the_telegrams(stage: Stage, fault: str, outside: bytes) -> None:
    stage.inject(fault)
    stage.rsi.cycles(3)
    (spoilt,) = [segment for segment in stage.eki.raw(4) if outside in segment]
    assert re.search(rb"<State .*</State>", spoilt)  # the telegram itself is whole
    stage.world.set_fault_script("")
    assert stage.reconnect().state(Id="8").get("RSI") == "2"


def test_a_channel_that_another_client_holds_refuses_every_other(stage: Stage) -> None:
    stage.inject("eki taken")
    stage.rsi.cycles(3)
    assert stage.eki.state(Id="8").get("RSI") == "2"  # who is there stays
    stage.eki.close()
    stage.rsi.cycles(10)
    with pytest.raises(ConnectionError):
        stage.reconnect().read()
    stage.world.set_fault_script("")
    stage.rsi.cycles(3)
    assert stage.reconnect().state(Id="8").get("RSI") == "2"


def test_a_silent_eki_program_neither_tells_nor_answers_until_it_goes_on(stage: Stage) -> None:
    stage.inject("eki silence")
    stage.rsi.cycles(5)
    stage.eki.settle()
    stage.eki.socket.sendall(b'<Cmd Id="5" Name="STATUS"></Cmd>')
    stage.rsi.cycles(100)
    assert stage.eki.hears_nothing(0.15)
    stage.world.set_fault_script("")
    stage.rsi.cycles(3)
    assert stage.eki.until(lambda element: element.get("Id") == "5").get("RSI") == "2"
