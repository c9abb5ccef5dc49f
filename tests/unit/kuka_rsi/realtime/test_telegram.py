"""Telegrams of the real-time link: which are accepted or rejected, and how the reply is written."""

from __future__ import annotations

import pytest
from coded_errors import raises
from hypothesis import example, given
from hypothesis import strategies as st

from drivers.kuka_rsi.errors import BAD_TELEGRAM
from drivers.kuka_rsi.realtime.telegram import (
    REPLY_TAIL,
    Element,
    ReplyWriter,
    TelegramReader,
    group_elements,
    read_currents,
    read_strictly,
)
from ronna_hw.wire.kuka_context import load_context

CONTEXT = load_context()
SEND = tuple(e.tag for e in CONTEXT.all_send)
AXES = ("AK.A1", "AK.A2", "AK.A3", "AK.A4", "AK.A5", "AK.A6")
READER = TelegramReader(SEND)
GOOD = (
    b'<Rob Type="KUKA"><RIst X="445.0000" Y="0.0000" Z="810.0000" A="180.0000" B="0.0000" C="180.0000"/>'
    b'<AIPos A1="1.0000" A2="-90.5000" A3="90.0000" A4="0.0000" A5="60.2500" A6="-10.0000"/>'
    b'<EIPos E1="0.0000" E2="0.0000" E3="0.0000" E4="0.0000" E5="0.0000" E6="0.0000"/>'
    b'<Delay D="3"/><MACur A1="0.1000" A2="-31.2500" A3="12.0000" A4="0.0000" A5="-4.5000" A6="0.0000"/>'
    b"<IPOC>4208163634</IPOC></Rob>"
)


def test_the_fast_reader_parses_the_exact_form_like_the_strict_one() -> None:
    telegram = READER.read(GOOD)
    assert telegram.axes_deg == (1.0, -90.5, 90.0, 0.0, 60.25, -10.0)
    assert telegram.delay == 3
    assert telegram.ipoc == b"4208163634"
    assert read_strictly(GOOD) == telegram
    assert read_currents(telegram.currents) == (0.1, -31.25, 12.0, 0.0, -4.5, 0.0)


@pytest.mark.parametrize("wrong", [b'A2="nan"', b'A2=""', b'A2="1e3"', b"", b'A2="-31.25" A2="-31.25"'])
def test_currents_that_are_not_six_plain_numbers_are_missing(wrong: bytes) -> None:
    attributes = READER.read(GOOD).currents
    assert read_currents(attributes.replace(b'A2="-31.2500"', wrong)) is None


def test_a_telegram_without_currents_has_none() -> None:
    data = GOOD[: GOOD.index(b"<MACur")] + GOOD[GOOD.index(b"<IPOC>") :]
    for reader in (READER, TelegramReader(SEND[:-1])):
        assert reader.match(data) is not None  # without the strict parser
        bare = reader.read(data)
        assert bare == READER.read(GOOD)._replace(currents=b"")
        assert read_currents(bare.currents) is None


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.replace(b"/>", b" />"),
        lambda t: t.replace(b"><", b">\r\n  <"),
        lambda t: b'<?xml version="1.0"?>' + t,
        lambda t: t + b"\0\0\0",
        lambda t: t.replace(b'Type="KUKA"', b'TYPE="KUKA"'),
        lambda t: t.replace(b'A1="1.0000"', b'A1="1"'),
        lambda t: t.replace(b'A1="1.0000"', b'A1="1.0e0"'),
        lambda t: t.replace(b'D="3"', b'D="3.0000"'),
        lambda t: t.replace(b"<Delay", b"<Extra>12</Extra><Delay"),
        lambda t: t.replace(b'"', b"'"),
    ],
)
def test_variants_in_spacing_quoting_and_number_form_parse_to_the_same_axes(change: object) -> None:
    assert callable(change)
    assert READER.read(change(GOOD)).axes_deg == READER.read(GOOD).axes_deg


def test_a_telegram_without_delay_has_a_delay_of_minus_one() -> None:
    assert READER.read(GOOD.replace(b'<Delay D="3"/>', b"")).delay == -1


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"<Rob></Rob>",
        GOOD[:-3],
        GOOD.replace(b"</AIPos", b"</Aipos").replace(b"A6=", b"A7="),
        GOOD.replace(b'A1="1.0000"', b'A1="one"'),
        GOOD.replace(b'A1="1.0000"', b'A1="1..0"'),
        GOOD.replace(b"4208163634", b"-4"),
        GOOD.replace(b"4208163634", b"4.2"),
        GOOD.replace(b"<IPOC>4208163634</IPOC>", b""),
        GOOD.replace(b"4208163634", b"<IPOC>42081</IPOC>63634"),  # no number that the bytes hold
        GOOD.replace(b"4208163634", b"9" * 20),  # the state row holds 64 bits
        GOOD.replace(b'D="3"', b'D="1e300"'),
        b"<!DOCTYPE Rob [<!ENTITY a 'b'>]>" + GOOD,
        b"\xff\xfe" + GOOD,
        *(b'<?xml version="1.0" encoding="%b"?>' % name + GOOD for name in (b"foo", b"hex", b"utf-7")),
        b"<Rob>" + b" " * 10_000 + b"</Rob>",
    ],
)
def test_a_malformed_telegram_is_rejected_with_its_last_bytes(data: bytes) -> None:
    with raises(BAD_TELEGRAM) as caught:
        READER.read(data)
    assert caught.value.code == "RSI-014"
    assert caught.value.wire == data[-64:]


def test_tags_become_elements_as_the_ethernet_file_defines() -> None:
    assert group_elements(("DEF_RIst", "DEF_Delay", "FREE", "DiO", "AK.A1", "AK.A2", "RK.A1")) == (
        Element("RIst", ("X", "Y", "Z", "A", "B", "C")),
        Element("Delay", ("D",)),
        Element("DiO", ()),
        Element("AK", ("A1", "A2")),
        Element("RK", ("A1",)),
    )
    (tech,) = group_elements(("DEF_Tech.C1", "DEF_Tech.C2"))
    assert tech.attributes[:2] == ("C11", "C12")
    assert tech.attributes[9:11] == ("C110", "C21")


def test_other_element_layouts_are_parsed() -> None:
    reader = TelegramReader(("DEF_AIPos", "DEF_ASPos", "Temperature", "DEF_Delay"))
    axes = b'A1="1.0" A2="2.0" A3="3.0" A4="4.0" A5="5.0" A6="6.0"/>'
    data = (
        b'<Rob Type="KUKA"><AIPos ' + axes + b"<ASPos " + axes + b"<Temperature>21.5</Temperature>"
        b'<Delay D="0"/><IPOC>7</IPOC></Rob>'
    )
    assert reader.read(data).axes_deg == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    delay_first = TelegramReader(("DEF_Delay", "DEF_AIPos"))
    data = b'<Rob Type="KUKA"><Delay D="5"/><AIPos ' + axes + b"<IPOC>7</IPOC></Rob>"
    assert delay_first.read(data).delay == 5


def test_the_reply_has_the_declared_elements_in_order() -> None:
    writer = ReplyWriter("KROSHU", tuple(e.tag for e in CONTEXT.receive), AXES, "Stop")
    assert writer.head((0.0, 1.5, -2.0, 0.0, 0.0, 1e-6)) + b"42" + REPLY_TAIL == (
        b'<Sen Type="KROSHU"><Stop>0</Stop><AK A1="0.000000" A2="1.500000" A3="-2.000000" A4="0.000000"'
        b' A5="0.000000" A6="0.000001"/><IPOC>42</IPOC></Sen>'
    )
    assert b"<Stop>1</Stop>" in writer.head((0.0,) * 6, stop=True)


@given(st.floats(-400.0, 400.0) | st.floats(-1e-5, 1e-5))
@example(-4e-7)
@example(-0.0)
def test_a_correction_is_rounded_to_six_decimals_and_is_never_negative_zero(value: float) -> None:
    writer = ReplyWriter("KROSHU", tuple(e.tag for e in CONTEXT.receive), AXES, "Stop")
    head = writer.head((value, 0.0, 0.0, 0.0, 0.0, value))
    assert head.count(b'"%.6f"' % (round(value, 6) + 0.0)) >= 2
    assert b"-0.000000" not in head


def test_reply_tags_without_a_source_are_sent_as_zero() -> None:
    writer = ReplyWriter("ImFree", ("EStr", *AXES, "EK.E1", "Stop"), AXES, "Stop")
    head = writer.head((1.0, 2.0, 3.0, 4.0, 5.0, 6.0), stop=True)
    assert head.startswith(b'<Sen Type="ImFree"><EStr>0</EStr><AK A1="1.000000"')
    assert head.endswith(b'<EK E1="0"/><Stop>1</Stop><IPOC>')
