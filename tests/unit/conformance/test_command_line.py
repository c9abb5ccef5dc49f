"""A wrong command line or an unreachable endpoint gives one message and the documented exit code."""

from __future__ import annotations

from pathlib import Path

import pytest

from conformance import cli
from ronna_hw.command_line.terminal import exit_code_of
from ronna_hw.errors import EXIT_FAILED, EXIT_NOT_FOUND

NOBODY = "tcp://127.0.0.1:1"


def message_of(capsys: pytest.CaptureFixture[str], *arguments: str, exit_code: int) -> str:
    assert exit_code_of(cli.app, ["tracker", *arguments]) == exit_code
    printed, message = capsys.readouterr()
    assert printed == ""
    assert len(message.splitlines()) == 1
    return message


def test_an_endpoint_where_nothing_listens_is_reported_as_not_found(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert message_of(capsys, "--endpoint", NOBODY, exit_code=EXIT_NOT_FOUND).startswith("NDI-001")


def test_an_unwritable_report_path_is_refused_before_connecting(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    report = str(tmp_path / "no" / "report.json")
    message = message_of(capsys, "--endpoint", NOBODY, "--report", report, exit_code=EXIT_FAILED)
    assert message.startswith("CLI-005")  # before anybody noticed that nobody is there
