"""Open questions about the robot controller, each with the parameter that sets the answer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from data_files import REFERENCE, read_rows
from page_tables import table

from sim.kuka.controller_parameters import ControllerParameters
from sim.named_parameters import rows


@dataclass(frozen=True)
class Question:
    """An open question; at least one of the answers is given."""

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


def read_questions() -> list[Question]:
    """The questions of the data file."""
    return read_rows(REFERENCE / "robot-open-questions.toml", "question", Question)


def robot_parameters() -> str:
    """The questions, then all parameters."""
    questions = [(one.subject, one.question, ", ".join(one.answers)) for one in read_questions()]
    return (
        table(("", "open question", "set by"), questions)
        + "\n## Parameters\n\n"
        + parameter_table(rows(ControllerParameters))
    )


def parameter_table(rows: Iterator[tuple[str, object, str]]) -> str:
    """Parameters of a simulator that stand for behaviour nobody has confirmed."""
    return table(
        ("parameter", "best estimate", "meaning"),
        [(f"`{name}`", value, meaning) for name, value, meaning in rows],
    )
