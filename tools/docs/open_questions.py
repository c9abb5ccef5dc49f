"""The page of open questions about the robot controller, each with the parameter that sets the answer.

The questions are in a data file. Tests check that every name in it exists, and that every parameter is either
named in it or concerns the simulation alone.
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
    """One open question; at least one of the answers is given."""

    subject: str
    question: str
    parameters: tuple[str, ...] = ()
    context: tuple[str, ...] = ()
    scene: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    otherwise: str = ""

    @property
    def answers(self) -> Iterator[str]:
        """The names that set the answer, as the page shows them."""
        yield from (f"`{name}`" for name in self.parameters)
        yield from (f"`{name}` of the context" for name in self.context)
        yield from (f"`arm.{name}` of the scene" for name in self.scene)
        yield from (f"`{name}`" for name in self.options)
        if self.otherwise:
            yield self.otherwise


def read_questions(path: Path = QUESTIONS_FILE) -> tuple[Question, ...]:
    """The questions of the data file; raises TypeError for surplus or missing keys."""
    entries = tomllib.loads(path.read_text(encoding="utf-8"))["question"]
    return tuple(
        Question(**{key: tuple(value) if isinstance(value, list) else value for key, value in one.items()})
        for one in entries
    )


def robot_parameters_page() -> str:
    """The page in Markdown: the questions, then all parameters."""
    lines = [
        "# Unconfirmed behaviour of the robot's controller\n",
        "No public source settles these. `ronna-sim kuka --set NAME=VALUE` changes the behaviour,",
        "as does `ronna-sim theatre --set robot.NAME=VALUE`. The first day with a real arm settles most.\n",
        "| | open question | set by |\n|---|---|---|",
    ]
    lines += [f"| {one.subject} | {one.question} | {', '.join(one.answers)} |" for one in read_questions()]
    lines += ["\n## Parameters\n", "| parameter | best estimate | meaning |\n|---|---|---|"]
    lines += [f"| `{name}` | {value} | {meaning} |" for name, value, meaning in parameter_rows()]
    return "\n".join(lines) + "\n"
