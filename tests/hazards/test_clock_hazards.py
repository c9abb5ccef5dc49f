"""Hazard 29: no limit depends on the wall clock, so it may jump."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("ronna_hw", "conformance", "drivers", "sim", "procedures", "studies")
WALL_CLOCK = {
    "time.time", "time.time_ns", "time.localtime", "time.gmtime",
    "datetime.now", "datetime.utcnow", "datetime.today", "date.today",
    "datetime.datetime.now", "datetime.datetime.utcnow", "datetime.date.today",
}  # fmt: skip
ASKED = {name.rpartition(".")[2] for name in WALL_CLOCK}
# A source without any of these words need not be parsed.
WORDS = re.compile(rf"\.\s*({'|'.join(sorted(ASKED))})\b|\bfrom\s+time\b")
# Where a date is wanted: on records, journal, events, recorded bytes, reports, and against an expiry date.
DATING = {
    "ronna_hw/records.py",
    "conformance/report.py",
    "sim/theatre/theatre_file.py",
    "sim/phantom",
    "sim/polaris/line/openigtlink_server.py",  # stamps in UTC, as PLUS has them
    "procedures/exchange/dicom_network/arrivals.py",
    "procedures/live/feed.py",  # UTC of theatre time 0
    "procedures/live/flight_log.py",
    "procedures/journal/journal.py",
    "procedures/guards/default_guards.py",
    "procedures/engine/events/stream.py",
    "procedures/engine/setting.py",
    "procedures/runs/comparison.py",
    "ronna_hw/recording/flight_recorder.py",
    "procedures/reporting/case_sheet/sheet.py",
    "procedures/reporting/sections/evidence.py",
    "procedures/runs/folders.py",
    "procedures/runs/theatre_history.py",
    "procedures/cli/doctor/report.py",
    "procedures/cli/tool/command.py",
    "procedures/exchange/sphere_files.py",
    "procedures/exchange/postoperative_objects.py",
    "procedures/steps/clinical/set_up.py",
    "procedures/steps/calibration",
}


def _wall_clock_uses() -> Iterator[str]:
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            where = path.relative_to(ROOT).as_posix()
            if where in DATING or path.parent.relative_to(ROOT).as_posix() in DATING:
                continue
            source = path.read_text(encoding="utf-8")
            for node in ast.walk(ast.parse(source)) if WORDS.search(source) else ():
                asks = isinstance(node, ast.Attribute) and node.attr in ASKED
                if asks and ast.unparse(node) in WALL_CLOCK:
                    yield f"{where}:{node.lineno} {ast.unparse(node)}"
                if isinstance(node, ast.ImportFrom) and node.module == "time":
                    names = {alias.name for alias in node.names}
                    if names & {"time", "time_ns", "localtime", "gmtime"}:
                        yield f"{where}:{node.lineno} from time import {', '.join(sorted(names))}"


@pytest.mark.hazard(29)
def test_the_wall_clock_only_dates_records_and_decides_nothing() -> None:
    assert list(_wall_clock_uses()) == []
