"""A script's lines in their order, but for `stop`, which counts while a step runs."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from bounded_cost import bounded_cost
from plain_steps import plain_order
from recording_cell import RecordingCell
from waiting import eventually

from procedures.cli.case.piped_lines import LONGEST_LINE, TOO_LONG, PipedLines, lines_from
from procedures.cli.case.prompt import Prompt
from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.order import Outcome
from procedures.journal.results import StepResult
from procedures.operator.question import Answer, Question, Topic

LIMIT_S = 10.0


class Pipe:
    """What the script writes into."""

    def __init__(self, descriptor: int) -> None:
        self.file = os.fdopen(descriptor, "wb", buffering=0)

    def write(self, text: str) -> None:
        self.file.write(text.encode())


@pytest.fixture
def pipe(monkeypatch: pytest.MonkeyPatch) -> Iterator[Pipe]:
    reads, writes = os.pipe()
    pipe = Pipe(writes)
    with os.fdopen(reads) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield pipe
        pipe.file.close()
        # Else it could read from what has this descriptor next.
        eventually(lambda: all(one.name != "standard input" for one in threading.enumerate()), LIMIT_S)


class Script:
    """Its prompt answers a pause."""

    def __init__(self, said: list[str]) -> None:
        self.lines = PipedLines()
        self.prompt = Prompt("step> ", said.append, piped=self.lines)

    def ask(self, question: Question) -> Answer:
        return self.prompt.ask(question) if question.topic is Topic.PAUSE else Answer(question.answers[0])

    def at(self, engine: Engine) -> None:
        self.lines.attach(engine)
        self.prompt.follow(engine)


@pytest.mark.hazard(36)
def test_stop_stops_the_arm_while_a_step_runs_and_the_script_says_how_it_goes_on(
    tmp_path: Path, pipe: Pipe
) -> None:
    cell, said = RecordingCell(tmp_path), list[str]()
    operator = Script(said)
    cell.operator = operator  # type: ignore[assignment]
    stopped = threading.Event()

    def stop() -> list[str]:
        stopped.set()
        return []

    cell.opened.stop = stop  # type: ignore[method-assign]

    def work(context: StepContext) -> Outcome[StepResult]:
        pipe.write("stop\nresume\nquit\n")
        assert stopped.wait(LIMIT_S)
        context.progress(0.5, "half")
        assert "Paused: a stop was ordered on the standard input; image, half" in said
        return plain.spec(context.key).run(context)

    plain = plain_order()
    engine = cell.engine(plain_order(image=work))
    pipe.write("next\n")
    operator.at(engine)
    assert engine.case.stands(engine.order.find("image"))
    assert ("rested", "") in cell.entries("rested")


def test_stop_while_nothing_runs_is_said_to_stop_nothing(cell: RecordingCell, pipe: Pipe) -> None:
    said: list[str] = []
    operator = Script(said)
    pipe.write("stop\nquit\n")
    operator.at(cell.engine(plain_order()))
    assert said[0].startswith("no step is running and the arm is at rest")
    assert cell.entries("rested") == []


def test_the_last_line_needs_no_end_and_the_end_is_read_as_often_as_asked(tmp_path: Path, pipe: Pipe) -> None:
    lines = PipedLines()
    pipe.write("list\nquit")
    lines.attach(RecordingCell(tmp_path).engine(plain_order()))
    assert lines.readline() == "list\n"
    assert not lines.wait_for_line(0.0)
    pipe.file.close()
    eventually(lambda: lines.wait_for_line(0.0), LIMIT_S)
    assert [lines.readline(), lines.readline(), lines.readline()] == ["quit", "", ""]


def test_a_line_of_ten_megabytes_is_no_command_and_the_next_line_is_read(pipe: Pipe) -> None:
    script = b"x" * 10_000_000 + b"\nstop\n" + b"y" * LONGEST_LINE + b"\nquit"

    def write() -> None:
        with pipe.file:
            left = memoryview(script)
            while left:
                left = left[pipe.file.write(left) :]

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    with bounded_cost(limit_s=2.0):
        lines = list(lines_from(sys.stdin.fileno()))
    writer.join(LIMIT_S)
    assert lines == [f"{TOO_LONG}\n", "stop\n", "y" * LONGEST_LINE + "\n", "quit"]


def test_a_line_that_is_too_long_is_reported_and_does_nothing(tmp_path: Path, pipe: Pipe) -> None:
    said: list[str] = []
    operator, cell = Script(said), RecordingCell(tmp_path)
    pipe.write(f"next{' ' * LONGEST_LINE}\nquit\n")
    operator.at(cell.engine(plain_order()))
    assert said[0].startswith(f"there is no command {TOO_LONG!r}")
    assert cell.entries("intent") == []
