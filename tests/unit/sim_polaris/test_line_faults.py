"""Line faults between host and unit."""

from __future__ import annotations

import pytest
from polaris_bench import Bench

from ronna_hw.wire.polaris import crc16
from sim.polaris.faults import LineFaults

OKAY = b"OKAYA896\r"
NO_HANDLES = b"001414\r"


def happen(bench: Bench, *lines: str) -> LineFaults:
    bench.disturb(*lines)
    return LineFaults(bench.unit)


def with_crc(text: str) -> bytes:
    return f"{text}{crc16(text.encode()):04X}".encode()


def conversation(bench: Bench, faults: LineFaults, line: bytes) -> bytes:
    """Send one line over the disturbed line; return the reply as received."""
    heard = faults.to_unit(line)
    return faults.to_host(heard, bench.interpreter.reply(heard))


def test_a_bit_error_in_a_command_with_crc_is_refused_and_has_no_effect(bench: Bench) -> None:
    faults = happen(bench, "garble commands 100 %")
    line = with_crc("TSTART:")  # CRC 5423 has no letters, so every bit error shows
    answers = {conversation(bench, faults, line)[:7] for _ in range(200)}
    # with the colon hit, the whole line is an unknown name
    assert answers == {b"ERROR04", b"ERROR01"}
    happen(bench)
    assert bench.send("TX ") == "ERROR0C"


def test_a_bit_error_in_a_command_without_crc_gives_an_unknown_name_or_a_bad_argument(bench: Bench) -> None:
    faults = happen(bench, "garble commands 100 %")
    answers = {conversation(bench, faults, b"PHSR 00")[:7] for _ in range(300)}
    assert {b"ERROR01", b"ERROR23"} <= answers


def test_a_garbled_reply_differs_in_exactly_one_bit(bench: Bench) -> None:
    faults = happen(bench, "garble replies 100 %")
    for _ in range(200):
        heard = conversation(bench, faults, b"PHSR 00")
        assert len(heard) == len(NO_HANDLES)
        differing = [
            sent ^ received for sent, received in zip(NO_HANDLES, heard, strict=True) if sent != received
        ]
        assert len(differing) == 1
        assert differing[0].bit_count() == 1


@pytest.mark.parametrize(("fault", "change"), [("drop bytes", -1), ("double bytes", 1)])
def test_a_byte_of_a_reply_is_lost_or_doubled(bench: Bench, fault: str, change: int) -> None:
    faults = happen(bench, f"{fault} 100 %")
    for _ in range(50):
        assert len(conversation(bench, faults, b"INIT ")) == len(OKAY) + change


def test_a_reply_is_truncated_or_lost(bench: Bench) -> None:
    faults = happen(bench, "cut replies 100 %")
    heard = {conversation(bench, faults, b"INIT ") for _ in range(100)}
    assert heard == {OKAY[:count] for count in range(len(OKAY))}
    faults = happen(bench, "lose replies 100 %")
    assert conversation(bench, faults, b"INIT ") == b""


def test_a_fault_affects_its_share_of_replies_reproducibly(bench: Bench) -> None:
    def broken() -> list[bool]:
        faults = happen(bench, "garble replies 20 %")
        return [conversation(bench, faults, b"INIT ") != OKAY for _ in range(500)]

    first = broken()
    assert 0.15 < sum(first) / len(first) < 0.25
    assert broken() == first


def test_theatre_time_passes_while_a_host_waits_for_a_lost_reply(bench: Bench) -> None:
    bench.world.set_fault_script("at 0 s: tracker lose replies 100 % for 5 s")
    faults = LineFaults(bench.unit)
    heard = []
    for _ in range(5):
        heard.append(conversation(bench, faults, b"PHSR 00"))  # a host gives it 2 s
    assert heard == [b"", b"", b"", NO_HANDLES, NO_HANDLES]


def test_a_delayed_reply_still_arrives(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    monkeypatch.setattr("sim.polaris.faults.time.sleep", slept.append)
    faults = happen(bench, "delay replies 3 s")
    began_s = bench.world.clock.now_s()
    assert conversation(bench, faults, b"INIT ") == OKAY
    assert slept == [3.0]
    assert bench.world.clock.now_s() - began_s == pytest.approx(3.0)
