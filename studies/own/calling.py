"""Calls a user method: its arguments cannot be modified, and its errors are reported with their line."""

from __future__ import annotations

import contextlib
import random
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from studies.errors import MethodAnswerWrong, MethodFailed
from studies.own.method import OwnMethod

GLOBAL_SEED = 0


@dataclass(frozen=True)
class OwnCallable:
    """A user method in this process, under its name; `result` and `form` say what it must return."""

    name: str
    function: Callable[..., Any]
    result: ClassVar[str]
    form: ClassVar[str]

    @classmethod
    def of(cls, method: OwnMethod) -> Self:
        """In this process. Raises STU-012."""
        return cls(method.name, method.function())

    def _wrong(self, got: str) -> MethodAnswerWrong:
        return MethodAnswerWrong(f"{self.name} did not return {self.result}", expected=self.form, got=got)


def called(
    name: str,
    function: Callable[..., Any],
    *arguments: object,
    passed: tuple[type[Exception], ...] = (),
    **named: object,
) -> Any:
    """The answer to these arguments; raises STU-013 for anything the method raises, except `passed`.

    The global generators are seeded before each call, so that a unit's result does not depend on its worker.
    What the method prints goes to standard error: standard output is for results.
    """
    random.seed(GLOBAL_SEED)
    np.random.seed(GLOBAL_SEED)  # for methods that use it
    try:
        with contextlib.redirect_stdout(sys.stderr):
            return function(*map(_guarded, arguments), **{key: _guarded(one) for key, one in named.items()})
    except passed:
        raise
    except (Exception, SystemExit) as error:
        raise MethodFailed(
            f"{name} raised {type(error).__name__}: {error}", got=_place(function, error)
        ) from error


def _guarded(value: object) -> object:
    """A read-only copy of an array; anything else unchanged."""
    if not isinstance(value, np.ndarray):
        return value
    copy = value.copy()
    copy.setflags(write=False)
    return copy


def _place(function: Callable[..., Any], error: BaseException) -> str:
    """The last line within the method's own file, otherwise the very last one."""
    frames = traceback.extract_tb(error.__traceback__)
    own_file = getattr(sys.modules.get(function.__module__), "__file__", None)
    last = next((one for one in reversed(frames) if one.filename == own_file), frames[-1])
    return f"{last.filename}, line {last.lineno}"
