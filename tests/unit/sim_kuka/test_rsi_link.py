"""Faults of the RSI link, without sockets: which telegrams each one affects, and how."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import pytest

from ronna_hw.wire.kuka_context import load_context
from sim.kuka.rsi.link import LinkFaults
from sim.kuka.rsi.telegrams import ReplyReader
from sim.world.faults import parse_faults
from sim.world.faults.log import FaultLog

REPLY = (
    '<Sen Type="KROSHU"><Stop>0</Stop><AK A1="1.500000" A2="0" A3="0" A4="0" A5="0" A6="0"/>'
    "<IPOC>%d</IPOC></Sen>"
)


def moment() -> tuple[float, str]:
    return 12.5, "IPOC 4208"


@pytest.fixture
def read() -> Callable[[bytes], Any]:
    context = load_context()
    return ReplyReader(context.receive, context.ethernet.sentype).read


@pytest.fixture
def link() -> Callable[..., LinkFaults]:
    def make(*lines: str, seed: int = 1) -> LinkFaults:
        faults = LinkFaults(seed, FaultLog(moment).hit)
        faults.set_active(parse_faults("\n".join(f"now: robot {line}" for line in lines)))
        return faults

    return make


def arrivals(faults: LinkFaults, read: Callable[[bytes], Any], cycles: int) -> list[int | None]:
    """Stamp of what arrives in each cycle when the client answers every one with the cycle's number."""
    seen = []
    for cycle in range(cycles):
        faults.cycle = cycle
        reply = faults.incoming((REPLY % cycle).encode(), read)
        seen.append(reply.ipoc if reply is not None else None)
    return seen


def test_a_delay_is_counted_in_cycles(link: Any, read: Any) -> None:
    assert arrivals(link("delay 3 cycles"), read, 8) == [None, None, None, 0, 1, 2, 3, 4]


def test_an_overtaken_reply_arrives_after_the_one_that_overtook_it(link: Any, read: Any) -> None:
    faults = link("reorder 100 %")
    assert arrivals(faults, read, 4) == [None, 0, 1, 2]
    faults.set_active(())
    faults.cycle = 4
    assert faults.incoming((REPLY % 4).encode(), read).ipoc == 4  # and cycle 3's reply behind it
    assert faults.idle


def test_nothing_passes_a_cut_network(link: Any, read: Any) -> None:
    faults = link("network cut")
    assert faults.outgoing(b"telegram") == (None, False)
    assert arrivals(faults, read, 3) == [None] * 3


def test_the_affected_cycles_depend_on_the_seed_and_not_on_earlier_cycles(link: Any, read: Any) -> None:
    whole = arrivals(link("drop 20 %"), read, 200)
    late = link("drop 20 %")
    late.cycle = 150
    tail = []
    for cycle in range(150, 200):
        late.cycle = cycle
        reply = late.incoming((REPLY % cycle).encode(), read)
        tail.append(reply.ipoc if reply is not None else None)
    assert whole[150:] == tail
    assert 20 < whole.count(None) < 60
    assert arrivals(link("drop 20 %", seed=2), read, 200) != whole


def test_wrong_ipoc_raises_the_time_stamp_by_one_in_its_share_of_replies(link: Any, read: Any) -> None:
    stamps = arrivals(link("wrong ipoc 50 %"), read, 400)
    wrong = [stamp for cycle, stamp in enumerate(stamps) if stamp != cycle]
    assert 100 < len(wrong) < 300
    assert all(stamp == cycle + 1 for cycle, stamp in enumerate(stamps) if stamp != cycle)


@pytest.mark.parametrize("fault", ["future ipoc", "missing ipoc", "wrong type", "bad number"])
def test_a_well_formed_but_invalid_reply_occurs_in_its_share_of_cycles(
    link: Any, read: Any, fault: str
) -> None:
    whole = arrivals(link(f"{fault} 0 %"), read, 100)
    assert whole == list(range(100))
    part = arrivals(link(f"{fault} 50 %"), read, 400)
    missed = [stamp for cycle, stamp in enumerate(part) if stamp != cycle]
    assert 100 < len(missed) < 300
    if fault == "future ipoc":
        assert all(stamp == cycle + 12 for cycle, stamp in enumerate(part) if stamp != cycle)
    else:
        assert set(missed) == {None}


def test_a_bad_number_is_nan_inf_or_a_word_and_each_of_them_occurs(link: Any) -> None:
    faults = link("bad number 100 %")
    seen: list[bytes] = []
    for cycle in range(100):
        faults.cycle = cycle
        faults.incoming((REPLY % cycle).encode(), seen.append)
    assert {data.split(b"<Stop>")[1].split(b"<")[0] for data in seen} == {b"nan", b"inf", b"one"}


def test_constant_ipoc_repeats_the_first_time_stamp_until_the_fault_ends(link: Any, read: Any) -> None:
    faults = link("constant ipoc")
    assert arrivals(faults, read, 5) == [0, 0, 0, 0, 0]
    faults.set_active(())
    faults.cycle = 7
    assert faults.incoming((REPLY % 7).encode(), read).ipoc == 7
    faults.set_active(parse_faults("now: robot constant ipoc"))
    faults.cycle = 9
    assert faults.incoming((REPLY % 9).encode(), read).ipoc == 9


@pytest.mark.parametrize(("takes_second", "value"), [(False, 2.5), (True, 1.5)])
def test_of_two_replies_to_one_telegram_the_configured_one_counts(
    read: Any, takes_second: bool, value: float
) -> None:
    faults = LinkFaults(1, FaultLog(moment).hit, takes_second=takes_second)
    faults.set_active(parse_faults("now: robot delay 2 cycles"))
    faults.cycle = 1
    assert faults.incoming((REPLY % 3).encode(), read) is None
    faults.set_active(())
    faults.cycle = 3
    again = (REPLY % 3).replace("1.500000", "2.500000").encode()
    reply = faults.incoming(again, read)
    assert reply is not None
    assert reply.values[1] == value  # the one that was on the way comes behind


def test_corrupt_replies_are_not_read_and_corrupt_telegrams_cannot_be_parsed(link: Any, read: Any) -> None:
    faults = link("corrupt replies 100 %", "corrupt telegrams 100 %")
    telegram = b'<Rob Type="KUKA"><AIPos A1="0.0" A2="0.0"/><IPOC>8</IPOC></Rob>'
    for cycle in range(2000):
        faults.cycle = cycle
        assert faults.incoming((REPLY % cycle).encode(), read) is None
        broken, answerable = faults.outgoing(telegram)
        assert not answerable
        assert broken is not None
        with pytest.raises(ElementTree.ParseError):
            ElementTree.fromstring(broken)


def test_the_log_shows_begin_end_and_each_occurrence_with_its_ipoc(
    capsys: pytest.CaptureFixture[str],
) -> None:
    log = FaultLog(moment)
    lasting = parse_faults("now: robot delay 2 cycles")
    (once,) = parse_faults("now: robot eki half telegram")
    log.update(lasting)
    log.update(lasting)
    log.hit("delay_replies")
    log.happened(once)
    log.update(())
    assert capsys.readouterr().err.splitlines() == [
        "fault at 12.500 s, IPOC 4208: robot delay 2 cycles begins",
        "fault at 12.500 s, IPOC 4208: robot eki half telegram",
        "fault at 12.500 s, IPOC 4208: robot delay 2 cycles ends after 1 telegrams",
    ]
