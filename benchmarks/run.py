"""Benchmark runner: runs the measurements, prints a table, and stores the figures.

    make bench
    make bench ONLY="stereo ct"

All figures with their conditions go to `benchmarks/results/<date>.json`, and what is compared from week to
week to `history.jsonl` there. Each measurement runs in its own process with a time limit; anything it
started ends with it. A missed goal is shown; a measurement that fails makes the command fail.
"""

from __future__ import annotations

import importlib
import json
import os
import platform
import subprocess
import sys
from dataclasses import asdict
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

import typer

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.append(str(ROOT))  # benchmarks are not installed; our packages are

from benchmarks import history  # noqa: E402
from benchmarks.figures import Figure  # noqa: E402
from benchmarks.isolation import end_with_runner, run_alone  # noqa: E402
from benchmarks.measurements import MEASUREMENTS, require_measurements  # noqa: E402
from ronna_hw.command_line.terminal import message_console, on_terminal, run  # noqa: E402
from ronna_hw.errors import EXIT_DONE, EXIT_FAILED  # noqa: E402
from ronna_hw.host.processor import name_processor  # noqa: E402

RESULTS = ROOT / "benchmarks" / "results"
LIMIT_S = 400.0  # per measurement; the robot link paces 100,000 telegrams and takes four minutes
LONGER_LIMITS_S = {
    "ur-link": 600.0,  # 60,000 packages in pace, and a dozen controllers
    "stereo-rate": 900.0,  # 12,000 pairs at up to 50 per second
    "recording": 900.0,  # four cases in real time
}
PEERS = (
    "ndicapi", "scikit-surgerynditracker", "RSIPI", "ur-rtde", "opencv-contrib-python-headless", "scipy",
    "numpy", "pydicom", "pynetdicom", "ruckig", "nicegui",
)  # fmt: skip

app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def bench(
    only: Annotated[list[str] | None, typer.Option(help="One of: " + ", ".join(MEASUREMENTS))] = None,
    out: Annotated[Path, typer.Option(help="Folder for the JSON file.")] = RESULTS,
    smallest: Annotated[
        bool,
        typer.Option(help="Only show that each measurement runs: its figures mean little, and are not kept."),
    ] = False,
    in_process: Annotated[str | None, typer.Option("--in-process", hidden=True)] = None,
) -> int:
    """Measure against bare baselines and peers in the same run."""
    if in_process is not None:
        with end_with_runner():
            figures = importlib.import_module(f"benchmarks.{MEASUREMENTS[in_process]}").measure(smallest)
        sys.stdout.write(json.dumps([asdict(figure) for figure in figures]))
        return EXIT_DONE
    names = only or list(MEASUREMENTS)
    require_measurements(names)
    figures_of: dict[str, list[Figure]] = {}
    failures: dict[str, str] = {}
    with message_console().status("measuring"):
        for name in names:
            try:
                figures_of[name] = _run_measurement(name, smallest)
            except (RuntimeError, ValueError) as problem:
                failures[name] = str(problem)
    _print_results(figures_of, failures)
    content = _describe_run(figures_of, failures)
    path = _write(out, content)
    sys.stdout.write(f"written to {path}\n")
    if not smallest:
        history.append_result(content, out / history.HISTORY.name)
    return EXIT_FAILED if failures else EXIT_DONE


def _run_measurement(name: str, smallest: bool) -> list[Figure]:
    """Run one measurement in its own process; raises RuntimeError quoting the end of its error output."""
    line = [sys.executable, "-P", __file__, "--in-process", name, *(["--smallest"] if smallest else [])]
    output = run_alone(line, LONGER_LIMITS_S.get(name, LIMIT_S))
    return [Figure(**figure) for figure in json.loads(output)]


def _print_results(figures_of: dict[str, list[Figure]], failures: dict[str, str]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if on_terminal(sys.stdout) else 160)
    table = Table(title="Medians of interleaved rounds", title_justify="left")
    for column in ("figure", "who", "value", "unit", "ratio", "goal"):
        table.add_column(column, justify="right" if column == "value" else "left", overflow="fold")
    for figures in figures_of.values():
        table.add_section()
        for figure in figures:
            ratio = "" if figure.ratio is None else f"{figure.ratio:.3g} x {figure.baseline}"
            goal = "" if figure.met is None else f"{figure.goal}: {'met' if figure.met else 'MISSED'}"
            table.add_row(figure.what, figure.who, _format_value(figure.value), figure.unit, ratio, goal)
    console.print(table)
    goals = [figure for figures in figures_of.values() for figure in figures if figure.met is not None]
    if goals:
        missed = [f"{figure.what}, {figure.who}" for figure in goals if not figure.met]
        summary = f"missed: {'; '.join(missed)}" if missed else "none missed"
        sys.stdout.write(f"goals met: {len(goals) - len(missed)} of {len(goals)}, {summary}\n")
    for name, reason in failures.items():
        sys.stderr.write(f"{name} was not measured: {reason}\n")


def _format_value(value: float) -> str:
    """Format a value with about four digits, avoiding exponents below ten million."""
    return f"{value:,.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.4g}"


def _describe_run(figures_of: dict[str, list[Figure]], failures: dict[str, str]) -> dict[str, Any]:
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": _read_commit(),
        "machine": {
            "processor": name_processor(),
            "cpus": os.cpu_count(),
            "load": os.getloadavg(),
            "platform": platform.platform(),
        },
        "python": platform.python_version(),
        "peers": {name: metadata.version(name) for name in PEERS},
        "figures": {name: [asdict(figure) for figure in figures] for name, figures in figures_of.items()},
        "failures": failures,
    }


def _write(folder: Path, content: dict[str, Any]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{datetime.fromisoformat(content['date']):%Y-%m-%dT%H%M%S}.json"
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")
    return path


def _read_commit() -> str:
    done = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip()


if __name__ == "__main__":
    run(app)
