"""Who sits at the terminal is told what to mount, and in a simulated room how."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest

from procedures.cli.case import operators
from procedures.cli.case.operators import TerminalRoom
from procedures.engine.operator import Task
from ronna_hw.wire.room_tasks import DEPTH_STOP, DIALS


@pytest.mark.parametrize("simulated", [True, False])
def test_only_in_a_simulated_room_a_command_mounts_the_tool(
    simulated: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    TerminalRoom(simulated=simulated).change_tool(2, "the surgical guide")
    told = capsys.readouterr().err
    assert told.startswith("Mount the surgical guide (tool 2).\n")
    assert ("ronna-sim mount 2 --control" in told) == simulated


def test_readings_are_typed_as_numbers_and_asked_again_otherwise(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typed = iter(["zero", "0,12", "nan", "0.1 0.2", "-0.05", "0.30"])
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr(operators, "_typed", lambda _what, _ends_s: next(typed))
    task = Task(DIALS, "read the three dials", reads=("x in mm", "y in mm", "z in mm"))
    assert TerminalRoom(simulated=True).work(task) == (0.12, -0.05, 0.30)
    told = capsys.readouterr().err
    assert told.startswith("Read the three dials.\n")
    assert "ronna-sim work dials --control" in told
    assert "'0.1 0.2' is not a number." in told


def test_what_the_stand_is_to_hold_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    TerminalRoom(simulated=True).prepare_stand("divot")
    assert capsys.readouterr().err.startswith("Put the divot on the calibration stand.\n")


@pytest.mark.parametrize("simulated", [True, False])
def test_work_is_told_and_without_a_terminal_nothing_is_read(
    simulated: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    task = Task(DEPTH_STOP, "set the depth stop for T1 to 165.00 mm", "T1", (165.0,), ("depth stop in mm",))
    assert TerminalRoom(simulated=simulated).work(task) == ()
    told = capsys.readouterr().err
    assert told.startswith("Set the depth stop for T1 to 165.00 mm.\n")
    assert ("ronna-sim work depth_stop 165 --trajectory T1 --control" in told) == simulated
