"""Hazard 6: numbers are shown whole, also extreme ones."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest

from procedures.cli.case.display import show_outcome
from procedures.engine.case import RECORDS_FOLDER
from procedures.engine.journal import Entry, Journal
from procedures.reporting.outcome import FinishedRun, RegistrationOutcome, TargetOutcome
from procedures.reporting.report import write_report

EXTREMES_MM = (0.0004, 0.0006, 9.9996, 12345.6789, 99999.9994)
SHOWN = ("0.000", "0.001", "10.000", "12345.679", "99999.999")
OUTCOME = FinishedRun(
    run="R",
    seed=0,
    strategy="ocs",
    markers=5,
    ct=None,
    registration=RegistrationOutcome(n=5, fre_mm=(0.1,)),
    targets=tuple(
        TargetOutcome(id=f"T{k}", depth_mm=123456.7, predicted_tre_mm=value, application_error_mm=value)
        for k, value in enumerate(EXTREMES_MM)
    ),
    mean_application_error_mm=12345.6789,
    max_application_error_mm=99999.9994,
    late_cycles=0,
    sim_s=1.0,
    wall_s=1.0,
    report="report.html",
)
ON_TERMINAL = (
    "import sys; from ronna_hw.command_line.console import print_table as t; t('errors', {head!r}, {rows!r})"
)


@pytest.mark.hazard(6)
def test_every_number_of_the_table_is_whole_off_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    show_outcome(OUTCOME, as_json=False)
    rows = [line.split("\t") for line in capsys.readouterr().out.splitlines()[1 : 1 + len(SHOWN)]]
    assert rows == [[f"T{k}", "123456.7", shown, shown] for k, shown in enumerate(SHOWN)]


@pytest.mark.hazard(6)
def test_every_number_of_the_report_is_whole(tmp_path: Path) -> None:
    (tmp_path / RECORDS_FOLDER).mkdir()
    journal = Journal(tmp_path)
    journal.write(Entry.OPENED, 0.0, theatre="bench", banner="SIMULATED THEATRE")
    journal.close()
    text = write_report(tmp_path, OUTCOME).read_text(encoding="utf-8")
    for k, shown in enumerate(SHOWN):
        row = f"<tr><td>T{k}</td><td>123456.7</td><td>{shown}</td><td>{shown}</td></tr>"
        assert row in text
    assert '<span class="big">12345.679 mm</span>' in text


def _on_terminal(columns: int) -> str:
    """What a table with the extreme numbers looks like on a terminal of that width."""
    rows = [["T1", "123456.7", shown, shown] for shown in SHOWN]
    program = ON_TERMINAL.format(head=["target", "depth mm", "predicted mm", "error mm"], rows=rows)
    primary, secondary = pty.openpty()
    try:
        subprocess.run(
            [sys.executable, "-P", "-c", program],
            stdout=secondary,
            stderr=subprocess.PIPE,
            env={**os.environ, "COLUMNS": str(columns), "TERM": "xterm"},
            timeout=150,
            check=True,
        )
    finally:
        os.close(secondary)
    text = b""
    while True:
        try:
            part = os.read(primary, 65536)
        except OSError:  # the line has hung up: everything was read
            break
        if not part:
            break
        text += part
    os.close(primary)
    return text.decode()


def _numbers(text: str) -> list[str]:
    return re.findall(r"\d+\.\d+", text)


@pytest.mark.hazard(6)
def test_every_number_is_whole_on_a_usual_terminal() -> None:
    text = _on_terminal(80)
    assert _numbers(text) == [number for shown in SHOWN for number in ("123456.7", shown, shown)]


@pytest.mark.hazard(6)
def test_every_number_is_whole_on_a_narrow_terminal() -> None:
    text = _on_terminal(30)
    assert _numbers(text) == [number for shown in SHOWN for number in ("123456.7", shown, shown)]
