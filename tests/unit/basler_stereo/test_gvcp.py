"""Control datagrams byte by byte."""

from __future__ import annotations

import pytest

from drivers.basler_stereo import gvcp
from drivers.basler_stereo.errors import CommandRefused, MalformedReply
from ronna_hw.wire.gige_vision import GvcpCommand


def test_a_register_write_has_the_bytes_of_the_standard():
    payload = gvcp.write_register_command(0x0A00, 2)
    datagram = gvcp.encode(GvcpCommand.WRITEREG, 0x1234, payload)
    assert datagram.hex() == "420100820008123400000a0000000002"


def test_a_memory_read_has_the_bytes_of_the_standard():
    payload = gvcp.read_memory_command(0x0200, 512)
    assert gvcp.encode(GvcpCommand.READMEM, 1, payload).hex() == "42010084000800010000020000000200"


def test_a_resend_request_asks_for_no_acknowledge():
    assert gvcp.encode_resend(7, 3, 10, 12).hex() == "42000040000c0007000000030000000a0000000c"


def test_an_answer_is_split_into_its_parts():
    answer = gvcp.decode(bytes.fromhex("000000810004123400000007"))
    assert answer == gvcp.GvcpAcknowledge(0, 0x81, 0x1234, bytes.fromhex("00000007"))
    assert gvcp.register_value(answer.payload, "x") == 7


@pytest.mark.parametrize("datagram", ["", "00000081", "000000810008123400000007"])
def test_a_datagram_shorter_than_its_stated_length_is_not_an_answer(datagram):
    assert gvcp.decode(bytes.fromhex(datagram)) is None


def test_a_refusal_names_the_status():
    with pytest.raises(CommandRefused, match=r"GEV-006.*access denied \(0x8006\)") as caught:
        gvcp.require_success(gvcp.GvcpAcknowledge(0x8006, 0x83, 1, b""), "writing")
    assert caught.value.status == 0x8006
    assert gvcp.status_name(0x8042) == "0x8042"


def test_answers_of_the_wrong_form_are_malformed():
    with pytest.raises(MalformedReply, match="GEV-008"):
        gvcp.register_value(b"\0\0", "x")
    with pytest.raises(MalformedReply, match="GEV-008"):
        gvcp.memory_data(bytes.fromhex("00000300") + bytes(8), 0x200, 8)
    with pytest.raises(MalformedReply, match="GEV-008"):
        gvcp.memory_data(bytes.fromhex("00000200") + bytes(4), 0x200, 8)


def test_a_pending_answer_states_how_long():
    assert gvcp.pending_ms(bytes.fromhex("00000190")) == 400
    assert gvcp.pending_ms(b"") == 0
