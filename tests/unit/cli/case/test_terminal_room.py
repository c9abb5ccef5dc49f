"""The user at the terminal is asked to mount tools, and in a simulated room is shown the command."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest

from procedures.cli.case import operators
from procedures.cli.case.operators import TerminalRoom
from procedures.operator.question import Task
from ronna_hw.wire.room_tasks import DEPTH_STOP, DIALS

THREE_DIALS = Task(
    DIALS, "read the three dials", reads=("x in mm", "y in mm", "z in mm"), plausible_mm=(-10.0, 10.0)
)


def typing(monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    typed = iter(lines)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr(operators, "_read_typed", lambda *_asked: next(typed))


@pytest.fixture(autouse=True)
def _no_control(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RONNA_CONTROL", raising=False)


def test_a_control_port_in_the_environment_is_left_out_of_the_mount_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RONNA_CONTROL", "tcp://127.0.0.1:9?token=x")
    TerminalRoom(simulated=True).change_tool(2, "the surgical guide")
    assert capsys.readouterr().err.endswith("In the simulated room: ronna-sim mount 2\n")


@pytest.mark.parametrize("simulated", [True, False])
def test_only_a_simulated_room_shows_a_mount_command(
    simulated: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    TerminalRoom(simulated=simulated).change_tool(2, "the surgical guide")
    said = capsys.readouterr().err
    assert said.startswith("Mount the surgical guide (tool 2).\n")
    assert ("ronna-sim mount 2 --control" in said) == simulated


def test_readings_are_typed_as_numbers_and_asked_again_otherwise(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typing(monkeypatch, "zero", "0,12", "nan", "0.1 cm", "-0.05 mm", "0.30mm", "y", "yes")
    assert TerminalRoom(simulated=True).work(THREE_DIALS) == (0.12, -0.05, 0.30)
    said = capsys.readouterr().err
    assert said.startswith("Read the three dials.\n")
    assert "ronna-sim work dials --control" in said
    refused = "'0.1 cm' is not a reading: type one number in mm, such as 0.01 or 0.01 mm"
    assert f"{refused}, or 'nobody' to end the step." in said
    assert "'y' is not an answer" in said


def test_an_implausible_reading_is_asked_again_at_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typing(monkeypatch, "100", "0.1", "0", "0", "yes")
    assert TerminalRoom().work(THREE_DIALS) == (0.1, 0.0, 0.0)
    assert "100 is implausible: expected -10 to 10;" in capsys.readouterr().err


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


def test_several_readings_are_shown_back_and_can_be_typed_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typing(monkeypatch, "1", "2", "3", "again", "1", "2", "4", "yes")
    assert TerminalRoom().work(THREE_DIALS) == (1.0, 2.0, 4.0)
    assert "  x in mm: 1\n  y in mm: 2\n  z in mm: 3\n" in capsys.readouterr().err


def test_answering_nobody_ends_the_reading_without_values(monkeypatch: pytest.MonkeyPatch) -> None:
    typing(monkeypatch, "1", "nobody")
    assert TerminalRoom().work(THREE_DIALS) == ()


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
    assert ("ronna-sim work depth_stop 165 --trajectory T1 --control" in said) == simulated
