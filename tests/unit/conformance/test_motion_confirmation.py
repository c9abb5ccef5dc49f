"""An arm that is not our simulator is moved only after a person has confirmed it by name."""

from __future__ import annotations

import io
import sys

import pytest

from conformance import cli
from conformance.report import Report
from ronna_hw.command_line.terminal import exit_code_of
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

    monkeypatch.setattr("conformance.report.run_suite", begin)
    return names


def _run(*arguments: str) -> int:
    return exit_code_of(cli.app, ["robot", *NOBODY, *arguments])


def test_motion_without_a_confirming_name_is_refused_before_connecting(
    confirmed: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("Ana\n"))  # no terminal: nobody can be asked
    assert _run("--allow", "motion") == EXIT_REFUSED
    assert _run("--allow", "motion", "--confirmed-by", "  ") == EXIT_REFUSED
    said = capsys.readouterr().err
    assert "CNF-005" in said
    assert "R11" in said
    assert "20 if a stop fails" in said
    assert confirmed == []


def test_the_user_at_the_terminal_is_asked_for_a_name(
    confirmed: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal(" Ana \n"))
    _run("--allow", "motion")
    assert confirmed == ["Ana"]
    assert "Confirmed by" in capsys.readouterr().err


def test_pressing_return_alone_does_not_confirm(
    confirmed: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal("\n"))
    assert _run("--allow", "motion") == EXIT_REFUSED
    assert confirmed == []


@pytest.mark.parametrize(
    "arguments", [(), ("--allow", "destructive"), ("--allow", "motion", "--only", "K01")]
)
def test_a_suite_without_motion_asks_for_no_confirmation(
    confirmed: list[str], arguments: tuple[str, ...]
) -> None:
    _run(*arguments)
    assert confirmed == [""]


def test_the_report_contains_the_name_of_the_confirming_person(confirmed: list[str]) -> None:
    _run("--allow", "motion", "--confirmed-by", "Ana")
    assert confirmed == ["Ana"]
    report = Report("robot", "kuka_rsi", {}, Identity("", "", "", ""), "", (), "Ana")
    assert report.as_document()["confirmed_by"] == "Ana"
