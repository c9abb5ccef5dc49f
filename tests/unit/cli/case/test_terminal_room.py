"""Staff at the terminal: told what to do, shown the command in a simulated room, or acting on a word."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import pytest

from procedures.cli.case import readings, staff
from procedures.cli.case.staff import TerminalRoom, WordedRoom
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Task
from ronna_hw.control_port import ControlRequestRefused
from ronna_hw.wire.room_tasks import DEPTH_STOP, DIALS, INSERT, OUT

THREE_DIALS = Task(
    DIALS, "read the three dials", reads=("x in mm", "y in mm", "z in mm"), plausible_mm=(-10.0, 10.0)
)


def typing(monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    typed = iter(lines)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    for module in (readings, staff):
        monkeypatch.setattr(module, "read_typed", lambda *_asked: next(typed))


@pytest.fixture(autouse=True)
def _no_control(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RONNA_CONTROL", raising=False)


@pytest.mark.parametrize("simulated", [True, False])
def test_only_a_simulated_room_shows_a_mount_command_without_the_control_port_of_the_environment(
    simulated: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RONNA_CONTROL", "tcp://127.0.0.1:9?token=x")
    TerminalRoom(simulated=simulated).change_tool(2, "the surgical guide")
    said = capsys.readouterr().err
    assert said.startswith("Mount the surgical guide (tool 2).\n")
    assert said.endswith("In the simulated room: ronna-sim mount 2\n") == simulated


def test_readings_are_typed_as_numbers_and_asked_again_otherwise(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typing(monkeypatch, "zero", "0,12", "nan", "0.1 cm", "-0.05 mm", "0.30mm", "y", "yes")
    assert TerminalRoom(simulated=True).work(THREE_DIALS) == (0.12, -0.05, 0.30)
    said = capsys.readouterr().err
    assert said.startswith("Read the three dials.\n")
    assert "ronna-sim work dials\n" in said
    refused = "'0.1 cm' is not a reading: type up to 2 numbers in mm, with spaces between: such as 0.01 0.01"
    assert f"{refused}, or 'nobody' to end the step." in said
    assert "'y' is not an answer" in said


@pytest.mark.parametrize(
    ("lines", "typed", "read"),
    [
        (
            ["0.12 -0.05 0.30", "0,12 -0,05 0,30", "0.12, -0.05, 0.30", "0.12 mm; -0.05mm; 0.30 mm"],
            ["yes"],
            (0.12, -0.05, 0.3),
        ),
        (
            ["0.1 0.2 0.3 0.4", "0.1 0.2 cm 0.3", "0.1 100 0.3", "0.1 0.2 nobody"],
            ["1 2", "3", "YES"],
            (1.0, 2.0, 3.0),
        ),
        (["1"], ["nobody"], ()),
    ],
    ids=["one line", "one wrong reading counts for none", "nobody"],
)
def test_several_readings_are_taken_from_one_line_or_several(
    lines: list[str], typed: list[str], read: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    for line in lines:
        typing(monkeypatch, line, *typed)
        assert TerminalRoom().work(THREE_DIALS) == read


def test_names_of_readings_say_once_what_they_share() -> None:
    assert readings.join_reads(THREE_DIALS.reads) == "x, y and z in mm"
    assert readings.join_reads(THREE_DIALS.reads[1:]) == "y and z in mm"
    assert readings.join_reads(("dial x of it", "dial upper x of it")) == "dial x and upper x of it"
    assert readings.join_reads(("depth",)) == "depth"


@pytest.mark.parametrize(
    ("typed", "read", "shown"),
    [
        ("100 0.1 0 0 yes", (0.1, 0.0, 0.0), "100 is implausible: expected -10 to 10;"),
        ("1 2 3 again 1 2 4 yes", (1.0, 2.0, 4.0), "  x in mm: 1\n  y in mm: 2\n  z in mm: 3\n"),
    ],
)
def test_an_implausible_reading_is_asked_again_at_once_and_all_can_be_typed_again_once_shown(
    typed: str,
    read: tuple[float, ...],
    shown: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    typing(monkeypatch, *typed.split())
    assert TerminalRoom().work(THREE_DIALS) == read
    assert shown in capsys.readouterr().err


def test_a_depth_stop_read_in_centimetres_is_asked_again_without_costing_an_attempt(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typing(monkeypatch, "18.24", "182.4")
    task = Task(DEPTH_STOP, "set it", reads=("depth stop in mm",), plausible_mm=(85.0, 250.0))
    assert TerminalRoom().work(task) == (182.4,)
    said = capsys.readouterr().err
    assert (
        "18.24 is implausible: expected 85 to 250; did you type centimetres?; type one number in mm" in said
    )
    assert "such as 168 or 168 mm" in said


def test_help_and_again_count_at_every_reading(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typing(monkeypatch, "help", "1 2", "again", "4", "5", "help", "6", "help", "yes")
    assert TerminalRoom(simulated=True).work(THREE_DIALS) == (4.0, 5.0, 6.0)
    said = capsys.readouterr().err
    assert "is not a reading" not in said
    assert "is not an answer" not in said
    assert "up to 3 numbers in mm" in said
    assert "'again' discards what was typed and begins with x in mm" in said
    assert "yes if these are the readings" in said
    assert said.count("Ctrl-C twice ends the command") == 3


def test_the_user_is_asked_to_put_the_object_on_the_stand(capsys: pytest.CaptureFixture[str]) -> None:
    TerminalRoom(simulated=True).prepare_stand("divot")
    assert capsys.readouterr().err.startswith("Put the divot on the calibration stand.\n")


@pytest.mark.parametrize("simulated", [True, False])
def test_work_is_shown_and_nothing_is_read_without_a_terminal(
    simulated: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    task = Task(DEPTH_STOP, "set the depth stop for T1 to 165.00 mm", "T1", (165.0,), ("depth stop in mm",))
    assert TerminalRoom(simulated=simulated).work(task) == ()
    said = capsys.readouterr().err
    assert said.startswith("Set the depth stop for T1 to 165.00 mm.\n")
    assert ("ronna-sim work depth_stop 165 --trajectory T1\n" in said) == simulated


class SimulatedStaff:
    """Staff who note what they are told, and read the same off every scale."""

    def __init__(self, *read_off: float) -> None:
        self.done: list[Any] = []
        self.read_off = read_off

    def announce(self, step: str) -> None:
        self.done.append(step)

    def change_tool(self, number: int, description: str) -> None:
        if number > 2:
            raise ControlRequestRefused(f"mount is refused: no tool {number}")
        self.done.append(number)

    def prepare_stand(self, holds: str) -> None:
        self.done.append(holds)

    def work(self, task: Task) -> tuple[float, ...]:
        self.done.append((task.name, task.trajectory, task.numbers))
        return self.read_off


INSERTION = Task(INSERT, "insert the instrument up to its stop", "T1")
STOP = Task(DEPTH_STOP, "set the depth stop", "T1", (165.0,), ("depth stop in mm",), (85.0, 250.0))


def test_a_tool_is_mounted_by_its_word_also_the_wrong_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typing(monkeypatch, "mount", "mount 7", "insert", "mnt 2", "Mount 1", "'mount 2'")
    told = SimulatedStaff()
    room = WordedRoom(told)
    room.change_tool(2, "the surgical guide")
    assert told.done == [1], "nothing is done before a word that fits, and a wrong tool is for the devices"
    said = capsys.readouterr().err
    for refused in (
        "mount needs the number of a tool",
        "no tool 7",
        "'insert' is not due now: type 'mount 2' or nobody",
        "'mnt 2' is no word for manual work",
    ):
        assert refused in said
    room.change_tool(2, "the surgical guide")
    assert told.done == [1, 2]


def test_work_is_done_by_its_word_and_what_the_scale_shows_is_typed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typing(monkeypatch, "depth_stop", "165.05", "depth_stop 160 mm", "160", "INSERT T2", "insert")
    told = SimulatedStaff(165.05)
    room = WordedRoom(told)
    assert room.work(STOP) == (165.05,)
    assert "You read off depth stop in mm: 165.05" in capsys.readouterr().err
    assert room.work(STOP) == (160.0,), "what is typed counts, not what the scale showed"
    told.read_off = ()
    assert room.work(INSERTION) == ()
    assert told.done == [("depth_stop", "T1", (165.0,)), ("depth_stop", "T1", (160.0,)), ("insert", "T1", ())]


@pytest.mark.parametrize("typed", ["nobody", ""])
def test_work_that_nobody_does_is_left_undone(typed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    typing(monkeypatch, typed, typed, typed)
    told = SimulatedStaff(165.05)
    room = WordedRoom(told)
    assert room.work(STOP) == ()
    room.change_tool(2, "the surgical guide")
    room.prepare_stand("ball")
    assert told.done == []


@pytest.mark.parametrize("typed", ["nobody", ""])
def test_an_instrument_that_nobody_takes_out_cannot_be_said_to_be_out(
    typed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    typing(monkeypatch, typed)
    told = SimulatedStaff()
    with pytest.raises(NotConfirmed, match="nobody has done this: remove the instrument from T1"):
        WordedRoom(told).work(Task(OUT, "remove the instrument from T1", "T1"))
    assert told.done == []


def test_help_lists_what_can_be_said_about_the_work_that_is_due(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typing(monkeypatch, "help", "stand gauge", "stand divot")
    told = SimulatedStaff()
    WordedRoom(told).prepare_stand("ball")
    assert told.done == ["divot"]
    said = capsys.readouterr().err
    assert "'stand ball' puts the ball on the stand" in said
    assert "'gauge' does not go on the stand: type stand nothing or stand ball or stand divot" in said
    assert "'nobody' leaves it undone" in said
