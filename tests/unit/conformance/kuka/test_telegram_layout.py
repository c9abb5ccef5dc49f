"""The byte-level cases of the robot suite catch what would break a real client's parser."""

from __future__ import annotations

import pytest

from conformance.case import Nonconformity, NotShown
from conformance.kuka.client import Telegram
from conformance.kuka.controller_cases import has_kr_c4_layout
from conformance.kuka.driver_cases import read_corrections

RIGHT = b'<Rob Type="KUKA"><AIPos A1="0.0000" A2="1.5000"/><Delay D="0"/><IPOC>4208163634</IPOC></Rob>'


def telegram(raw: bytes) -> Telegram:
    return Telegram(raw, ("127.0.0.1", 1), 0.0)


def test_the_layout_of_a_kr_c4_passes() -> None:
    assert has_kr_c4_layout(RIGHT)


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        (b'1.5000" />', b'1.5000"/>'),
        (b"/>\n<Delay", b"/><Delay"),
        (b"'0.0000'", b'"0.0000"'),
        (b'<Delay D="0"></Delay>', b'<Delay D="0"/>'),
        (b'Type="ImFree"', b'Type="KUKA"'),
        (b"</IPOC><Delay/></Rob>", b"</IPOC></Rob>"),
    ],
)
def test_a_layout_that_would_break_a_positional_parser_fails(wrong: bytes, right: bytes) -> None:
    assert right in RIGHT
    assert not has_kr_c4_layout(RIGHT.replace(right, wrong))


def test_a_delay_that_is_not_an_integer_fails_and_a_missing_one_is_inconclusive() -> None:
    with pytest.raises(Nonconformity):
        _ = telegram(RIGHT.replace(b'D="0"', b'D="0.0"')).late
    with pytest.raises(NotShown):
        _ = telegram(RIGHT.replace(b'<Delay D="0"/>', b"")).late


def test_a_reply_without_a_correction_fails() -> None:
    with pytest.raises(Nonconformity):
        read_corrections(b'<Sen Type="KROSHU"><Stop>0</Stop><IPOC>1</IPOC></Sen>')
