"""Fault script of a simulated theatre, as far as a run reads it: its steps, its times and its lines.

What a line does, only the theatre knows; its command reads the script before a case starts.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from procedures.engine.errors import CommandRefused
from ronna_hw.bounded_input import read_bounded
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.errors import EXIT_DONE, EXIT_USAGE
from ronna_hw.host.child_process import command, run_command
from ronna_hw.near_names import find_near

FAULT_COMMAND = "ronna-sim fault"
READ_TIMEOUT_S = 60.0  # host time; it takes a second
LARGEST_SCRIPT_BYTES = 1_000_000  # more than the theatre itself takes
_STEP_OF_LINE = re.compile(r"\s*(?:when|since)\s+step\s*==\s*(?P<step>\w+)(?P<trajectory>:[\w.-]+)?")
_TIME_OF_LINE = re.compile(r"\s*at\s+(?P<at_s>\d+(?:\.\d*)?)\s*s\b")


class UnreadableFault(UsageMistake):
    """The theatre cannot read a fault of the command line; the error has the theatre's code and words."""

    action = ""  # the theatre's words end with it

    def __init__(self, message: str) -> None:
        self.code, _, what = message.strip().partition(": ")
        super().__init__(what)


def check_fault_lines(path: Path) -> None:
    """Raise the theatre's own error, SIM-003, if the fault script contains a line that it cannot read.

    PRO-013 if the command that reads it fails otherwise, PRC-001 if it hangs.
    """
    ended = run_command(FAULT_COMMAND, command("sim.cli", "fault", "--check", str(path)), READ_TIMEOUT_S)
    if ended.returncode == EXIT_USAGE:
        raise UnreadableFault(ended.stderr)
    if ended.returncode != EXIT_DONE:
        raise CommandRefused(FAULT_COMMAND, ended.stderr, ended.returncode)


def check_fault_script(path: Path, step_names: Collection[str], once: Collection[str] = ()) -> None:
    """Raise CLI-001 if the fault script is missing or refers to unknown steps.

    Steps that run `once`, for all trajectories, are not those of one: a fault of one would never begin.
    """
    if not path.is_file():
        raise UsageMistake(f"there is no fault script {path}", action="Give the path of a file.")
    found = [(number, match) for number, line in _lines(path) if (match := _STEP_OF_LINE.match(line))]
    wrong, nearest = [], dict[str, None]()
    for number, match in found:
        step, trajectory = match["step"], match["trajectory"]
        if step not in step_names:
            wrong.append(f"line {number}: there is no step {step!r}")
            nearest |= dict.fromkeys(find_near(step, step_names))
        elif step in once and trajectory:
            wrong.append(f"line {number}: {step!r} runs once for all trajectories, not for {trajectory[1:]}")
    if wrong:
        others = ", ".join(name for name in step_names if name not in nearest)
        raise UsageMistake(
            f"{path.name}, {'; '.join(wrong)}",
            expected=f"{', '.join(nearest)}, or another of {others}" if nearest else f"one of {others}",
            action="Correct the fault script; ronna-procedure steps lists the steps of a case, with the "
            "--fiducials and --dual that it has.",
        )


def list_unreached_faults(path: Path, begun_steps: Iterable[str], theatre_time_s: float) -> Iterator[str]:
    """Yield a message for each fault whose step or time the case never reached."""
    steps = {name for step in begun_steps for name in (step, step.partition(":")[0])}
    for number, line in _lines(path):
        if match := _STEP_OF_LINE.match(line):
            step = match["step"] + (match["trajectory"] or "")
            if step not in steps:
                yield f"line {number} of {path.name} had no effect: the case did not run {step}"
        elif (match := _TIME_OF_LINE.match(line)) and float(match["at_s"]) > theatre_time_s:
            yield f"line {number} of {path.name} had no effect: the case ended after {theatre_time_s:.1f} s"


def read_fault_lines(path: Path) -> tuple[str, ...]:
    """Return the lines of a fault script without comments; none if there is no such file."""
    if not path.is_file():  # a request is also written for the record where no theatre is started
        return ()
    return tuple(filter(None, (line.partition("#")[0].strip() for _, line in _lines(path))))


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    text = read_bounded(path, LARGEST_SCRIPT_BYTES).decode(errors="replace")
    return enumerate(text.splitlines(), 1)
