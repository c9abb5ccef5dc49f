"""Profiler for a simulated case: CPU seconds by process and step, and a flame graph of all processes.

    make profile
    make profile CASE="--scene mini --seed 3"

The case runs twice: watched from outside for the table, and under py-spy for the flame graph.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, NamedTuple

import psutil
import typer
from rich.console import Console
from rich.table import Table

from ronna_hw.evidence.journal_reading import JOURNAL_FILE, Entry, read_journal

PERIOD_S = 0.05  # between two looks at the processes; what a process needs in its last period is lost
RATE_HZ = 200  # samples of py-spy
BEFORE, AFTER = "start-up", "end"
ROLES = {  # word of a command line: process
    "drivers.kuka_rsi.realtime.process": "RSI process",
    "drivers.basler_stereo.stream.receiver_process": "receiver",
    "procedures.imaging.dicom.decoder_process": "frame decoder",
    "kuka": "controller",
    "polaris": "tracker",
    "basler": "cameras",
    "theatre": "theatre",
}
SCRIPTS = Path(sys.executable).parent

app = typer.Typer(add_completion=False)


class Used(NamedTuple):
    """CPU seconds used by a process during one sampling period."""

    at_s: float  # host time, seconds since the epoch
    role: str
    processor_s: float


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def profile(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="Folder for flame graph and run folders.")] = Path("profiles"),
    flame: Annotated[bool, typer.Option(help="Run the case a second time, under py-spy.")] = True,
) -> None:
    """Run a simulated case with these options of `ronna-procedure run` and print where its time went."""
    folder = out / datetime.now().astimezone().strftime("%Y-%m-%d-%H%M%S")
    folder.mkdir(parents=True)
    command = [str(SCRIPTS / "ronna-procedure"), "run", "--sim", *context.args]
    started_s = time.time()
    used = list(watch([*command, "--out", str(folder / "watched")]))
    wall_s = time.time() - started_s
    show(used, steps(next((folder / "watched").glob(f"*/{JOURNAL_FILE}"))), wall_s)
    if flame:
        graph = folder / "flame.svg"
        record = [str(SCRIPTS / "py-spy"), "record", "--subprocesses", "--nonblocking", "--function"]
        record += ["--rate", str(RATE_HZ), "--output", str(graph), "--"]
        subprocess.run(
            [*record, *command, "--out", str(folder / "sampled")], check=True, stdout=subprocess.DEVNULL
        )
        sys.stdout.write(f"flame graph: {graph}\n")


def watch(command: Sequence[str]) -> Iterator[Used]:
    """Run a command and yield the CPU usage of its processes by period. Raises CalledProcessError."""
    before: dict[psutil.Process, float] = {}
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as running:
        program = psutil.Process(running.pid)
        while running.poll() is None:
            for process in (program, *program.children(recursive=True)):
                try:
                    times, words = process.cpu_times(), process.cmdline()
                except psutil.Error:  # it has just ended
                    continue
                total_s = times.user + times.system
                yield Used(time.time(), role_of(words), total_s - before.get(process, 0.0))
                before[process] = total_s
            time.sleep(PERIOD_S)
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, command)


def role_of(words: Sequence[str]) -> str:
    """Return the role of the process with this command line, `program` for the main one."""
    return next((role for word, role in ROLES.items() if word in words[1:6]), "program")


def steps(journal: Path) -> list[tuple[float, str]]:
    """Return the host start time (s) and name of each step, followed by `end`."""
    starts, ended_s = [], 0.0
    for line in read_journal(journal):
        at_s = datetime.fromisoformat(str(line["host_time"])).timestamp()
        if line["entry"] == Entry.INTENT:
            starts.append((at_s, str(line["step"])))
        elif line["entry"] == Entry.RESULT:
            ended_s = at_s
    return [*starts, (ended_s, AFTER)]


def show(used: Sequence[Used], starts: Sequence[tuple[float, str]], wall_s: float) -> None:
    """Print CPU seconds by step and process."""
    names = [BEFORE, *(name for _, name in starts)]
    cells: defaultdict[tuple[str, str], float] = defaultdict(float)
    for one in used:
        begun = sum(at_s <= one.at_s for at_s, _ in starts)
        cells[names[begun], one.role] += one.processor_s
    roles = sorted({one.role for one in used}, key=lambda role: -sum(cells[name, role] for name in names))
    first_s = used[0].at_s
    begins_s = [first_s, *(at_s for at_s, _ in starts)]
    ends_s = [*begins_s[1:], first_s + wall_s]
    table = Table(title="Processor seconds by step and process", title_justify="left")
    for column in ("step", "wall", "all", *roles):
        table.add_column(column, justify="left" if column == "step" else "right")
    for name, begin_s, end_s in zip(names, begins_s, ends_s, strict=True):
        row = [cells[name, role] for role in roles]
        table.add_row(name, f"{end_s - begin_s:.2f}", f"{sum(row):.2f}", *(f"{value:.2f}" for value in row))
    table.add_section()
    totals = [sum(cells[name, role] for name in names) for role in roles]
    table.add_row("case", f"{wall_s:.2f}", f"{sum(totals):.2f}", *(f"{total:.2f}" for total in totals))
    Console(width=120).print(table)


if __name__ == "__main__":
    app()
