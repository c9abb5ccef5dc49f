"""The session keeps command and reply together whatever the line does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.ndi_polaris.errors import (
    BadReplyCrc,
    CommandGarbled,
    LinkLost,
    MalformedReply,
    NoReply,
    UnitRestarted,
    WrongMode,
)
from drivers.ndi_polaris.parameters import read_parameter
from drivers.ndi_polaris.session import Session


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
def session(unit: Any) -> Session:
    session = Session(unit, monotonic=lambda: unit.now_s)
    session.ask("INIT")
    return session


def test_a_reply_with_a_wrong_crc_is_asked_for_once_more(session: Session, unit: Any) -> None:
    once(unit, lambda reply: [(0.001, b"X" + reply[1:])])
    assert session.ask("APIREV") == "G.001.005"
    assert session.statistics.retries == 1
    assert [line for line in unit.commands if line.startswith("ECHO")]


def test_a_reply_that_stays_wrong_is_an_error(session: Session, unit: Any) -> None:
    unit.deliver = lambda name, reply: [(0.001, reply if name == "ECHO" else b"X" + reply[1:])]
    with pytest.raises(BadReplyCrc):
        session.ask("APIREV")


def test_a_command_that_must_not_be_repeated_is_sent_once(session: Session, unit: Any) -> None:
    once(unit, lambda reply: [(0.001, b"X" + reply[1:])])
    with pytest.raises(BadReplyCrc):
        session.ask("PHRQ", "*********1****", retry=False)
    assert sum(line.startswith("PHRQ") for line in unit.commands) == 1


def test_a_command_garbled_on_its_way_is_repeated(session: Session, unit: Any) -> None:
    once(unit, lambda reply: [(0.001, b"ERROR046802\r")])
    assert session.ask("APIREV") == "G.001.005"
    unit.answers_to["APIREV"] = "ERROR04"
    with pytest.raises(CommandGarbled):
        session.ask("APIREV")


@pytest.mark.hazard(16)
def test_a_late_reply_is_never_taken_for_the_next_one(session: Session, unit: Any) -> None:
    once(unit, lambda reply: [(0.6, reply)])
    with pytest.raises(NoReply):
        session.ask("APIREV", deadline_s=unit.now_s + 0.5)
    # the answer to APIREV arrives while the next command is waited for
    unit.deliver = lambda name, reply: [(0.3, reply)]
    assert session.ask("GET", "Features.Firmware.Version").startswith("Features.Firmware.Version=")


def test_a_reply_that_comes_twice_does_not_put_the_session_out_of_step(session: Session, unit: Any) -> None:
    for delay_s in (0.001, 0.002, 0.09):
        once(unit, lambda reply, delay_s=delay_s: [(0.001, reply), (delay_s, reply)])
        assert session.ask("APIREV") == "G.001.005"
        unit.now_s += 0.1
        assert session.ask("GET", "Param.Tracking.Selected Volume").endswith("Volume=0")
        unit.now_s += 1.0


def test_a_late_copy_is_not_taken_for_the_value_of_a_parameter(session: Session, unit: Any) -> None:
    once(unit, lambda reply: [(0.001, reply), (0.3, reply)])
    assert session.ask("APIREV") == "G.001.005"
    assert read_parameter(session, "Features.Firmware.Version", None) == "007.000.012"


def test_a_parameter_that_the_unit_does_not_name_is_refused(session: Session, unit: Any) -> None:
    unit.answers_to["GET"] = "OKAY"
    with pytest.raises(MalformedReply):
        read_parameter(session, "Features.Firmware.Version", None)


def test_the_time_limit_is_the_units_own_plus_the_transfer(unit: Any) -> None:
    session = Session(unit, monotonic=lambda: unit.now_s)
    assert session.limit_s("BX", 12, 948) == pytest.approx(4.0 + 9600 / 9600)
    unit.set_baud(115200)
    assert session.limit_s("TSTOP", 10, 0) == pytest.approx(2.0 + 100 / 115200)


def test_a_unit_that_answers_just_within_its_limit_is_not_given_up(session: Session, unit: Any) -> None:
    once(unit, lambda reply: [(3.9, reply)])
    assert session.ask("INIT") == "OKAY"


def test_silence_within_the_units_limits_is_a_time_out_and_beyond_them_a_lost_link(
    session: Session, unit: Any
) -> None:
    unit.silent = True
    outcomes = []
    for _ in range(12):
        with pytest.raises((NoReply, LinkLost)) as caught:
            session.ask("APIREV", deadline_s=unit.now_s + 0.5)
        outcomes.append(type(caught.value))
    assert outcomes[0] is NoReply
    assert outcomes[-1] is LinkLost
    unit.silent = False
    assert session.ask("APIREV") == "G.001.005"


def test_a_reply_that_stops_in_the_middle_is_noticed_before_the_time_limit(
    session: Session, unit: Any
) -> None:
    unit.deliver = lambda name, reply: [(0.001, reply if name == "ECHO" else reply[:5])]
    began_s = unit.now_s
    with pytest.raises(MalformedReply):
        session.ask("APIREV")
    assert unit.now_s - began_s < 2.0


def test_an_announced_reset_ends_the_session(session: Session, unit: Any) -> None:
    unit._arrivals.append((unit.now_s, b"RESETBE6F\r"))
    with pytest.raises(UnitRestarted):
        session.ask("APIREV")
    unit.restart()
    with pytest.raises(UnitRestarted):
        session.ask("GET", "Features.Firmware.Version")


def test_a_unit_without_echo_is_brought_back_in_step_by_its_refusals(session: Session, unit: Any) -> None:
    unit.answers_to["ECHO"] = "ERROR01"
    once(unit, lambda reply: [(0.001, reply[:-3])])
    assert session.ask("APIREV") == "G.001.005"


def test_a_line_that_never_stops_talking_is_an_error(session: Session, unit: Any) -> None:
    class Babble:
        baud = None

        def write(self, data: bytes) -> None: ...

        def read(self, timeout_s: float) -> bytes:
            return b"x" * 50_000

    babbling = Session(Babble(), monotonic=lambda: 0.0)  # type: ignore[arg-type]
    with pytest.raises(MalformedReply):
        babbling.ask("APIREV")


def test_an_error_reply_is_not_repeated(session: Session, unit: Any) -> None:
    with pytest.raises(WrongMode) as caught:
        session.ask("TSTOP")
    assert caught.value.vendor_code == 0x0C
    assert unit.commands.count("TSTOP:") == 1
