"""Void what a refusal asks to have done again, so that the case goes back to it by itself.

Otherwise the refused step could be repeated with the same scan only, and be refused with the same words.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from procedures.engine.context import StepContext
from procedures.journal.results import StepResult
from ronna_hw.errors import AnyCode, RonnaError, is_error


@dataclass(frozen=True)
class Repeat:
    """Result that some refusals void, and what then happens, for the operator."""

    model: type[StepResult]
    then: str
    problems: tuple[AnyCode[RonnaError], ...]


@contextmanager
def repeat_if_refused(context: StepContext, *repeats: Repeat) -> Iterator[None]:
    """Void the result of the first of `repeats` that names the error of the block, and say what follows."""
    try:
        yield
    except RonnaError as problem:
        repeat = next((one for one in repeats if is_error(problem, *one.problems)), None)
        if repeat is None:
            raise
        again = problem.reworded(
            problem.what,
            expected=problem.expected,
            limit=problem.limit,
            got=problem.got,
            action=f"{problem.advice} {repeat.then}",
        )
        context.void_each(repeat.model, again)
        raise again from problem
