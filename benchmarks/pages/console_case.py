"""Effect of an open console page on a case: step times and robot link turnaround.

The mini case in real time, with and without: in lock-step a telegram waits for us and has no turnaround.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from datetime import datetime
from pathlib import Path
from typing import Any

from modest_chromium import MISSING, modest_chromium, opened_context
from operated_case import OperatedCases, enter

from benchmarks.figures import Figure

SCENE = ("--scene", "mini", "--seed", "3", "--speed")
LIMIT_S = 150.0
WITH, WITHOUT = "with console and page", "without"
MOST_TIMES_LONGER, MOST_TIMES_SLOWER = 1.05, 1.2


def measure(speed: str = "1") -> list[Figure]:
    """Measure the effect of the console. Returns no figures if Chromium is missing."""
    if MISSING:
        return []
    with tempfile.TemporaryDirectory() as place:
        bare = _read_figures(_run_alone(Path(place) / "alone", speed))
        watched = _read_figures(_run_watched(Path(place), speed))
    figures = []
    for what, unit, most in (
        ("time of the steps", "s", MOST_TIMES_LONGER),
        ("turnaround, median", "us", MOST_TIMES_SLOWER),
        ("turnaround, 99 %", "us", None),
        ("late and lost cycles", "", None),
    ):
        ratio = watched[what] / bare[what] if bare[what] else None
        figure = Figure(what, WITH, watched[what], unit, ratio, WITHOUT)
        figures += [figure if most is None else figure.at_most(most * bare[what])]
        figures += [Figure(what, WITHOUT, bare[what], unit)]
    return figures


def _run_alone(out: Path, speed: str) -> Path:
    line = [sys.executable, "-P", "-m", "procedures.cli.procedure", "run", "--sim", *SCENE, speed, "--json"]
    subprocess.run([*line, "--out", str(out)], check=True, capture_output=True, timeout=LIMIT_S)
    return next(out.iterdir())


def _run_watched(folder: Path, speed: str) -> Path:
    with modest_chromium(folder) as browser:
        start = OperatedCases(folder)
        case = start("run", "--json", scene=(*SCENE, speed))
        page = opened_context(browser).new_page()
        enter(page, case.addresses["viewer_url"] + "&low")
        if case.process.wait(LIMIT_S):
            raise RuntimeError(case.said)
        return case.run


def _read_figures(run: Path) -> dict[str, float]:
    journal = [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()]
    records = [json.loads(path.read_text()) for path in sorted((run / "records").glob("*.json"))]
    link = [one["payload"]["link"] for one in records if one["kind"] == "retreat"][-1]
    return {
        "time of the steps": _sum_steps_s(journal),
        "turnaround, median": link["turnaround_median_us"],
        "turnaround, 99 %": link["turnaround_p99_us"],
        "late and lost cycles": float(link["late_cycles"] + link["lost_cycles"]),
    }


def _sum_steps_s(journal: list[dict[str, Any]]) -> float:
    """Return the total host time between the intent and the result of each step, in seconds."""
    total_s, began = 0.0, None
    for line in journal:
        if line["entry"] == "intent":
            began = datetime.fromisoformat(line["host_time"])
        elif line["entry"] == "result" and began is not None:
            total_s += (datetime.fromisoformat(line["host_time"]) - began).total_seconds()
            began = None
    return total_s
