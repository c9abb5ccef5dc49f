"""The page of what is not known about the robot's controller: each question, and the name that answers it.

The questions stand in a data file; that every name there exists, and every parameter stands there or belongs
to the simulation alone, is tested.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sim.kuka.controller_parameters import parameter_rows

QUESTIONS_FILE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "robot-open-questions.toml"
PAGE = "robot-parameters.md"


@dataclass(frozen=True)
class Question:
    """One open question; at least one of the answers is there."""

    subject: str
    question: str
    parameters: tuple[str, ...] = ()
    context: tuple[str, ...] = ()
    scene: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    otherwise: str = ""

    @property
    def answers(self) -> Iterator[str]:
        """The names that answer it, as a reader finds them."""
        yield from (f"`{name}`" for name in self.parameters)
        yield from (f"`{name}` of the context" for name in self.context)
        yield from (f"`arm.{name}` of the scene" for name in self.scene)
        yield from (f"`{name}`" for name in self.options)
        if self.otherwise:
            yield self.otherwise


def read_questions(path: Path = QUESTIONS_FILE) -> tuple[Question, ...]:
    """The questions of the data file; raises TypeError for a word too much or too few."""
    entries = tomllib.loads(path.read_text(encoding="utf-8"))["question"]
    return tuple(
        Question(**{key: tuple(value) if isinstance(value, list) else value for key, value in one.items()})
        for one in entries
    )


def robot_parameters_page() -> str:
    """The page in Markdown: the questions, then all parameters."""
    lines = [
        "# Unconfirmed behaviour of the robot's controller\n",
        "No public source settles these. `ronna-sim kuka --set NAME=VALUE` chooses another answer,",
        "`ronna-sim theatre --set robot.NAME=VALUE` too. The first day with a real arm settles most.\n",
        "| | open question | answered by |\n|---|---|---|",
    ]
    lines += [f"| {one.subject} | {one.question} | {', '.join(one.answers)} |" for one in read_questions()]
    lines += ["\n## Parameters\n", "| parameter | best estimate | meaning |\n|---|---|---|"]
    lines += [f"| `{name}` | {value} | {meaning} |" for name, value, meaning in parameter_rows()]
    return "\n".join(lines) + "\n"
