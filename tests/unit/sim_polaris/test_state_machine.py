"""Operating modes, and the order in which the unit checks a command."""

from __future__ import annotations

import pytest
from polaris_bench import Bench, MakeBench

from sim.polaris.unit.model import SPECTRA
from sim.world.scene.model import TrackerTool

SETUP_ONLY = (
    "SFLIST 00", "SSTAT 0001", "VSEL 1", "IRATE 2", "PHSR 00", "PHRQ *********1****", "PHF 01",
    "PVWR 010000" + "00" * 64, "PINIT 01", "PENA 01D", "PDIS 01", "PHINF 01", "TSTART 80",
)  # fmt: skip
TRACKING_ONLY = ("TSTOP ", "TX 0001", "BX 0001")
ALWAYS = ("APIREV ", "VER 0", "COMM 00000", "ECHO x", "BEEP 1", "GET Info.Timeout.INIT", "GETINFO Features.*")


@pytest.mark.parametrize("line", [*SETUP_ONLY, *TRACKING_ONLY, "SET Param.User.String0=x"])
def test_before_init_setup_and_tracking_commands_are_refused(make_bench: MakeBench, line: str) -> None:
    assert make_bench().send(line) == "ERROR10"


@pytest.mark.parametrize("line", ALWAYS)
def test_identity_and_settings_can_be_read_before_init(make_bench: MakeBench, line: str) -> None:
    assert not make_bench().send(line).startswith("ERROR")


@pytest.mark.parametrize("line", SETUP_ONLY)
def test_setup_commands_are_refused_while_tracking(bench: Bench, line: str) -> None:
    bench.send("TSTART 80")
    assert bench.send(line) == "ERROR0C"
    assert bench.send("TSTOP ") == "OKAY"


def test_identity_can_be_read_while_tracking(bench: Bench) -> None:
    bench.send("TSTART ")
    assert not [line for line in ALWAYS if bench.send(line).startswith("ERROR")]


def test_init_returns_to_setup_from_tracking_and_forgets_handles(bench: Bench, pointer: TrackerTool) -> None:
    bench.track(pointer)
    assert bench.send("INIT ") == "OKAY"
    assert bench.send("PHSR 00") == "00"


def test_reset_requires_init_and_restores_the_default_rate(bench: Bench) -> None:
    assert bench.send("COMM 50000") == "OKAY"
    assert bench.interpreter.reply_line.baud == 9600
    assert bench.send("ECHO x") == "x"
    assert bench.interpreter.reply_line.baud == 115200
    assert bench.send("RESET 0") == "RESET"
    assert bench.interpreter.reply_line.baud == 9600
    assert bench.send("PHSR 00") == "ERROR10"


def test_an_unknown_command_is_reported_before_the_mode(make_bench: MakeBench) -> None:
    assert make_bench().send_with_crc("NONSENSE:") == "ERROR01"
    assert make_bench().send("init ") == "ERROR01"


def test_the_mode_is_checked_before_the_arguments_and_those_before_the_handle(bench: Bench) -> None:
    assert bench.send("TX nonsense") == "ERROR0C"
    assert bench.send("PENA 01") == "ERROR07"
    assert bench.send("PENA 01X") == "ERROR09"
    assert bench.send("PENA xxD") == "ERROR08"
    assert bench.send("PENA 01D") == "ERROR2B"


def test_a_line_longer_than_any_command_is_refused(bench: Bench) -> None:
    from sim.polaris.unit.framing import LineBuffer

    long = b"ECHO " + b"x" * SPECTRA.longest_command + b"\r"
    (line,) = LineBuffer(SPECTRA.longest_command).feed(long, 0.0)
    assert bench.interpreter.reply(line).startswith(b"ERROR02")


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("COMM 00", "ERROR07"),
        ("COMM Z0000", "ERROR23"),
        ("COMM 00300", "ERROR23"),
        ("BEEP 1", "1"),
        ("BEEP 0", "ERROR23"),
        ("BEEP 10", "ERROR07"),
        ("ECHO a b:c", "a b:c"),
        ("VER 5", "024"),
        ("VER 3", "ERROR19"),
        ("VER 9", "ERROR23"),
        ("VER ", "ERROR07"),
        ("INIT 1", "ERROR07"),
        ("APIREV ", "G.001.005"),
        ("SFLIST 00", "00000016"),
        ("SFLIST 99", "ERROR23"),
        ("SFLIST", "ERROR07"),
        ("SSTAT 0007", "000000"),
        ("SSTAT 0001", "00"),
        ("SSTAT 0008", "ERROR23"),
        ("VSEL 2", "OKAY"),
        ("VSEL 3", "ERROR24"),
        ("VSEL 0", "ERROR24"),
        ("IRATE 3", "ERROR23"),
        ("TSTART 1", "ERROR07"),
        ("TSTART 01", "ERROR23"),
        ("PHSR 05", "ERROR23"),
        ("PHSR 0", "ERROR07"),
    ],
)
def test_arguments_are_checked(bench: Bench, line: str, answer: str) -> None:
    assert bench.send(line) == answer


@pytest.mark.parametrize(
    ("argument", "answer"),
    [("0000", "ERROR23"), ("0100", "ERROR23"), ("zzzz", "ERROR23"), ("1", "ERROR07"), ("00001", "ERROR07")],
)
def test_unknown_options_of_tx_and_bx_are_refused_as_text(bench: Bench, argument: str, answer: str) -> None:
    bench.send("TSTART 80")
    assert bench.send(f"TX {argument}") == answer
    assert bench.send(f"BX {argument}") == answer
