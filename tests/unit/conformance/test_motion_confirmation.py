"""An arm that is no simulator of ours is moved only when a person has confirmed it, by name."""

from __future__ import annotations

import io
import sys

import pytest

from ronna_hw.command_line.terminal import exit_code_of
from ronna_hw.conformance import cli
from ronna_hw.conformance.report import Report
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.errors import EXIT_REFUSED

NOBODY = ("--endpoint", "rsi=udp://127.0.0.1:59152", "--endpoint", "eki_project=tcp://127.0.0.1:1")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def confirmed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """By whom a run that was begun was confirmed; nothing is run."""
    names: list[str] = []

    def begin(*_: object, confirmed_by: str = "") -> Report:
        names.append(confirmed_by)
        return Report("robot", "kuka_rsi", {}, Identity("", "", "", ""), "", (), confirmed_by)

    monkeypatch.setattr("ronna_hw.conformance.report.run_suite", begin)
    return names


def _run(*arguments: str) -> int:
    return exit_code_of(cli.app, ["robot", *NOBODY, *arguments])


def test_without_a_name_nothing_is_even_connected(
    confirmed: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("Ana\n"))  # no terminal: nobody can be asked
    assert _run("--allow", "motion") == EXIT_REFUSED
    assert _run("--allow", "motion", "--confirmed-by", "  ") == EXIT_REFUSED
    told = capsys.readouterr().err
    assert "CNF-005" in told
    assert "R11" in told
    assert "20 if a stop fails" in told
    assert confirmed == []


def test_a_person_at_the_terminal_is_asked(
    confirmed: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal(" Ana \n"))
    _run("--allow", "motion")
    assert confirmed == ["Ana"]
    assert "Confirmed by" in capsys.readouterr().err


def test_who_just_presses_return_has_not_confirmed(
    confirmed: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal("\n"))
    assert _run("--allow", "motion") == EXIT_REFUSED
    assert confirmed == []


@pytest.mark.parametrize(
    "arguments", [(), ("--allow", "destructive"), ("--allow", "motion", "--only", "K01")]
)
def test_what_moves_nothing_asks_nobody(confirmed: list[str], arguments: tuple[str, ...]) -> None:
    _run(*arguments)
    assert confirmed == [""]


def test_the_name_stands_in_the_report(confirmed: list[str]) -> None:
    _run("--allow", "motion", "--confirmed-by", "Ana")
    assert confirmed == ["Ana"]
    report = Report("robot", "kuka_rsi", {}, Identity("", "", "", ""), "", (), "Ana")
    assert report.as_document()["confirmed_by"] == "Ana"
