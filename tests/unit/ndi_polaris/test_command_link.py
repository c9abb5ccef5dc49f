"""The command link keeps commands and replies in step, whatever the line does."""

from __future__ import annotations

import math
import struct
import tracemalloc
from collections.abc import Callable
from typing import Any

import pytest
from hostile_devices import with_right_crcs
from polaris_mutations import Campaign, crc_by_definition, whole_binary, whole_text
from polaris_unit_in_process import Deliveries, StillClock, UnitInProcess, bring_up, tracker_on
from recorded_bytes import RecordedBytes

from drivers.ndi_polaris.command_link import CommandLink, decode_ascii, split_binary
from drivers.ndi_polaris.discovery import RESET_LIMIT_S, await_reset
from drivers.ndi_polaris.errors import (
    BadReplyCrc,
    CommandGarbled,
    LinkLost,
    MalformedReply,
    NoReply,
    UnitRestarted,
    WrongMode,
)
from drivers.ndi_polaris.unit import read_parameter
from ronna_hw.devices.capabilities import RecordsBytes
from ronna_hw.errors import RonnaError
from ronna_hw.wire.polaris import BX_START, crc16


def once(unit: Any, change: Callable[[bytes], list[tuple[float, bytes]]], name: str | None = None) -> None:
    """Deliver the next reply (of one command) differently."""
    usual = unit.deliver

    def deliver(command: str, reply: bytes) -> list[tuple[float, bytes]]:
        if name is not None and command != name:
            return usual(command, reply)
        unit.deliver = usual
        return change(reply)

    unit.deliver = deliver


@pytest.fixture
def link(unit: Any) -> CommandLink:
    link = CommandLink(unit, monotonic=lambda: unit.now_s)
    link.ask("INIT")
    return link


def test_a_reply_with_a_wrong_crc_is_requested_again(link: CommandLink, unit: Any) -> None:
    once(unit, lambda reply: [(0.001, b"X" + reply[1:])])
    assert link.ask("APIREV") == "G.001.005"
    assert link.statistics.retries == 1
    assert [line for line in unit.commands if line.startswith("ECHO")]


def test_a_reply_that_stays_corrupt_is_an_error(link: CommandLink, unit: Any) -> None:
    unit.deliver = lambda name, reply: [(0.001, reply if name == "ECHO" else b"X" + reply[1:])]
    with pytest.raises(BadReplyCrc):
        link.ask("APIREV")


def test_a_command_that_must_not_be_repeated_is_sent_once(link: CommandLink, unit: Any) -> None:
    once(unit, lambda reply: [(0.001, b"X" + reply[1:])])
    with pytest.raises(BadReplyCrc):
        link.ask("PHRQ", "*********1****", retry=False)
    assert sum(line.startswith("PHRQ") for line in unit.commands) == 1


@pytest.mark.parametrize("refusal", [b"ERROR046802\r", b"ERROR016BC2\r"], ids=["CRC", "colon"])
def test_a_command_garbled_in_transit_is_repeated(link: CommandLink, unit: Any, refusal: bytes) -> None:
    once(unit, lambda reply: [(0.001, refusal)])
    assert link.ask("APIREV") == "G.001.005"
    unit.answers_to["APIREV"] = "ERROR04"
    with pytest.raises(CommandGarbled):
        link.ask("APIREV")


@pytest.mark.hazard(16)
def test_a_late_reply_is_never_taken_for_the_reply_to_the_next_command(link: CommandLink, unit: Any) -> None:
    once(unit, lambda reply: [(0.6, reply)])
    link.deadline_s = unit.now_s + 0.5
    with pytest.raises(NoReply):
        link.ask("APIREV")
    link.deadline_s = math.inf
    # the answer to APIREV arrives while the next command is waited for
    unit.deliver = lambda name, reply: [(0.3, reply)]
    assert link.ask("GET", "Features.Firmware.Version").startswith("Features.Firmware.Version=")


def test_a_duplicated_reply_does_not_put_the_session_out_of_step(link: CommandLink, unit: Any) -> None:
    for delay_s in (0.001, 0.002, 0.09):
        once(unit, lambda reply, delay_s=delay_s: [(0.001, reply), (delay_s, reply)])
        assert link.ask("APIREV") == "G.001.005"
        unit.now_s += 0.1
        assert link.ask("GET", "Param.Tracking.Selected Volume").endswith("Volume=0")
        unit.now_s += 1.0


def test_a_late_duplicate_is_not_taken_for_a_parameter_value(link: CommandLink, unit: Any) -> None:
    once(unit, lambda reply: [(0.001, reply), (0.3, reply)])
    assert link.ask("APIREV") == "G.001.005"
    assert read_parameter(link, "Features.Firmware.Version") == "007.000.012"


def test_a_parameter_reply_that_does_not_name_the_parameter_is_refused(link: CommandLink, unit: Any) -> None:
    unit.answers_to["GET"] = "OKAY"
    with pytest.raises(MalformedReply):
        read_parameter(link, "Features.Firmware.Version")


def test_the_time_limit_is_the_units_own_plus_the_transfer_time(unit: Any) -> None:
    link = CommandLink(unit, monotonic=lambda: unit.now_s)
    assert link.limit_s("BX", 12, 948) == pytest.approx(4.0 + 9600 / 9600)
    unit.set_baud(115200)
    assert link.limit_s("TSTOP", 10, 0) == pytest.approx(2.0 + 100 / 115200)


def test_a_reply_just_within_the_units_time_limit_is_accepted(link: CommandLink, unit: Any) -> None:
    once(unit, lambda reply: [(3.9, reply)])
    assert link.ask("INIT") == "OKAY"


def test_silence_within_the_units_limits_is_a_timeout_and_beyond_them_a_lost_link(
    link: CommandLink, unit: Any
) -> None:
    unit.silent = True
    outcomes = []
    for _ in range(12):
        link.deadline_s = unit.now_s + 0.5
        with pytest.raises((NoReply, LinkLost)) as caught:
            link.ask("APIREV")
        outcomes.append(type(caught.value))
    assert outcomes[0] is NoReply
    assert outcomes[-1] is LinkLost
    unit.silent, link.deadline_s = False, math.inf
    assert link.ask("APIREV") == "G.001.005"


def test_a_truncated_reply_is_detected_before_the_time_limit(link: CommandLink, unit: Any) -> None:
    unit.deliver = lambda name, reply: [(0.001, reply if name == "ECHO" else reply[:5])]
    began_s = unit.now_s
    with pytest.raises(MalformedReply):
        link.ask("APIREV")
    assert unit.now_s - began_s < 2.0


def test_an_announced_reset_ends_the_session(link: CommandLink, unit: Any) -> None:
    unit.send_unasked(b"RESETBE6F\r")
    with pytest.raises(UnitRestarted):
        link.ask("APIREV")
    unit.restart()
    with pytest.raises(UnitRestarted):
        link.ask("GET", "Features.Firmware.Version")


def test_a_unit_without_echo_is_resynchronised_by_its_refusals(link: CommandLink, unit: Any) -> None:
    unit.answers_to["ECHO"] = "ERROR01"
    once(unit, lambda reply: [(0.001, reply[:-3])])
    assert link.ask("APIREV") == "G.001.005"


def test_a_line_that_never_stops_sending_is_an_error(link: CommandLink) -> None:
    class Babble:
        baud = None

        def write(self, data: bytes) -> None: ...

        def read(self, timeout_s: float) -> bytes:
            return b"x" * 50_000

    babbling = CommandLink(Babble(), monotonic=lambda: 0.0)  # type: ignore[arg-type]
    with pytest.raises(MalformedReply):
        babbling.ask("APIREV")


def test_a_command_answered_by_an_error_is_not_repeated(link: CommandLink, unit: Any) -> None:
    with pytest.raises(WrongMode) as caught:
        link.ask("TSTOP")
    assert caught.value.vendor_code == 0x0C
    assert unit.commands.count("TSTOP:") == 1


BRINGS_UP_S = 30.0  # three calls with their usual limits
CLOSES_IN_S = 2.0
FLOOD_BYTES = 22_000_000
SOAK = (pytest.mark.soak, pytest.mark.timeout(3600))


class CutLine(UnitInProcess):
    """Line that ends after so many bytes from the unit: at once if `hung_up`, or by silence."""

    def __init__(self, left: int, *, hung_up: bool) -> None:
        super().__init__(baud=None)
        self.left = left
        self._hung_up = hung_up
        self.deliver = self._cut

    def _cut(self, _command: str, reply: bytes) -> Deliveries:
        passed, self.left = reply[: self.left], max(0, self.left - len(reply))
        return [(0.001, passed)] if passed else []

    def read(self, timeout_s: float) -> bytes:
        data = super().read(timeout_s)
        self.closed = self._hung_up and not self.left and not data
        return data


@pytest.mark.parametrize("hung_up", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_line_that_ends_after_any_byte_of_a_bring_up_is_an_error_with_a_code(hung_up: bool) -> None:
    endless = 1 << 30
    whole = CutLine(endless, hung_up=hung_up)
    bring_up(tracker_on(whole, StillClock(), "tcp://127.0.0.1:8765"))
    codes = set()
    for count in range(endless - whole.left):
        unit = CutLine(count, hung_up=hung_up)
        device = tracker_on(unit, StillClock(), "tcp://127.0.0.1:8765")
        with pytest.raises(RonnaError) as raised:
            bring_up(device)
        assert unit.now_s < BRINGS_UP_S, f"after byte {count}"
        codes.add(raised.value.code)
        began_s = unit.now_s
        device.close()
        assert unit.now_s - began_s < CLOSES_IN_S, f"after byte {count}"
    assert all(code.startswith("NDI-") for code in codes)
    assert len(codes) > 1


def test_a_line_that_is_never_quiet_costs_no_memory_while_a_reset_is_awaited() -> None:
    class Flood(UnitInProcess):
        heard = 0

        def read(self, timeout_s: float) -> bytes:
            self.heard += 65536
            self.now_s += min(timeout_s, RESET_LIMIT_S * 65536 / FLOOD_BYTES)
            return b"A" * 65536

    unit = Flood()
    link = CommandLink(unit, monotonic=lambda: unit.now_s)
    tracemalloc.start()
    try:
        assert not await_reset(link)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert unit.heard >= FLOOD_BYTES
    assert most < 1_000_000


def test_all_bytes_on_the_line_and_changes_of_rate_are_recorded(make_tracker) -> None:
    tracker, sink = make_tracker(), RecordedBytes()
    assert isinstance(tracker, RecordsBytes)
    tracker.record_bytes(sink)
    with tracker.active():
        tracker.read_frame()
    tracker.close()
    assert b"TSTART:" in sink.sent("tracker")
    assert sink.received("tracker").count(b"OKAYA896\r") > 3
    assert sink.notes[-1][0] == "tracker"
    assert "baud" in sink.notes[-1][1]


@pytest.mark.hazard(16)
@pytest.mark.parametrize(
    ("reply", "replies", "seed"),
    [
        ("BX", 3_000, 1),
        ("TX", 2_000, 1),
        pytest.param("BX", 12_000, 1, marks=pytest.mark.slow),
        pytest.param("TX", 8_000, 1, marks=pytest.mark.slow),
        *(  # a million
            pytest.param("BX" if seed % 2 else "TX", 100_000, seed, marks=SOAK) for seed in range(100, 110)
        ),
    ],
)
def test_no_corrupted_reply_is_accepted_and_two_commands_recover_the_link(
    reply: str, replies: int, seed: int
) -> None:
    campaign = Campaign(seed, reply=reply)
    campaign.run(replies)
    assert campaign.mutated >= replies
    assert campaign.accepted > replies / 4  # the line was whole between the bursts
    assert {"NDI-005", "NDI-006", "NDI-007", "NDI-008"} <= set(campaign.errors)


def test_the_campaign_distinguishes_intact_replies_from_corrupted_ones() -> None:
    assert crc_by_definition(b"OKAY") == 0xA896
    assert whole_text(b"remains\rOKAYA896\rOKAYA897\r") == [b"OKAY"]
    reply = bytes.fromhex("C4A50D002983010102310000002D01000000009E7D")
    assert whole_binary(b"\xc4" + reply + reply[:-1]) == [reply[6:-2]]
    assert whole_binary(reply[:8] + b"\0" + reply[9:]) == []


@pytest.mark.parametrize("true", [b"0101", b"VER 1\n2"])
def test_a_text_that_lies_is_opened(true: bytes) -> None:
    reply = true + b"%04X\r" % crc16(true)
    told = with_right_crcs(reply, true.replace(b"1", b"9999") + reply[len(true) :])
    assert decode_ascii(told.removesuffix(b"\r")) == true.replace(b"1", b"9999").decode()


@pytest.mark.parametrize(("length", "read"), [(4, b"\xff\xff\xff\xff"), (5, None)])
def test_a_binary_reply_that_lies_is_opened_and_one_of_another_length_waited_for(
    length: int, read: bytes | None
) -> None:
    head, body = struct.pack("<HH", BX_START, 4), b"\1\2\3\4"
    reply = b"".join(part + struct.pack("<H", crc16(part)) for part in (head, body))
    told = with_right_crcs(reply, b"\0\0" + struct.pack("<H", length) + b"\0\0" + b"\xff" * 4 + b"\0\0")
    opened = split_binary(told)
    assert (opened and opened[0]) == read
