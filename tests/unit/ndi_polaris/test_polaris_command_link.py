"""The command link keeps commands and replies in step, whatever the line does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.ndi_polaris.command_link import CommandLink
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


def once(unit: Any, change: Callable[[bytes], list[tuple[float, bytes]]], name: str | None = None) -> None:
    """Let the next reply (of one command) be delivered differently."""
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
    with pytest.raises(NoReply):
        link.ask("APIREV", deadline_s=unit.now_s + 0.5)
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
    assert read_parameter(link, "Features.Firmware.Version", None) == "007.000.012"


def test_a_parameter_reply_that_does_not_name_the_parameter_is_refused(link: CommandLink, unit: Any) -> None:
    unit.answers_to["GET"] = "OKAY"
    with pytest.raises(MalformedReply):
        read_parameter(link, "Features.Firmware.Version", None)


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
        with pytest.raises((NoReply, LinkLost)) as caught:
            link.ask("APIREV", deadline_s=unit.now_s + 0.5)
        outcomes.append(type(caught.value))
    assert outcomes[0] is NoReply
    assert outcomes[-1] is LinkLost
    unit.silent = False
    assert link.ask("APIREV") == "G.001.005"


def test_a_truncated_reply_is_detected_before_the_time_limit(link: CommandLink, unit: Any) -> None:
    unit.deliver = lambda name, reply: [(0.001, reply if name == "ECHO" else reply[:5])]
    began_s = unit.now_s
    with pytest.raises(MalformedReply):
        link.ask("APIREV")
    assert unit.now_s - began_s < 2.0


def test_an_announced_reset_ends_the_session(link: CommandLink, unit: Any) -> None:
    unit._arrivals.append((unit.now_s, b"RESETBE6F\r"))
    with pytest.raises(UnitRestarted):
        link.ask("APIREV")
    unit.restart()
    with pytest.raises(UnitRestarted):
        link.ask("GET", "Features.Firmware.Version")


def test_a_unit_without_echo_is_resynchronised_by_its_refusals(link: CommandLink, unit: Any) -> None:
    unit.answers_to["ECHO"] = "ERROR01"
    once(unit, lambda reply: [(0.001, reply[:-3])])
    assert link.ask("APIREV") == "G.001.005"


def test_a_line_that_never_stops_sending_is_an_error(link: CommandLink, unit: Any) -> None:
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
