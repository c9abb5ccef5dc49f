"""Context managers that say how they are used when somebody forgets the `with`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import wraps
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, TypeVar

T = TypeVar("T")
Given = ParamSpec("Given")


class Opening(AbstractContextManager[T], Generic[T]):
    """Context manager of a call; what it opens is there only inside of the `with` statement."""

    def __init__(self, manager: AbstractContextManager[T], call: str) -> None:
        self._manager, self._call = manager, call

    def __enter__(self) -> T:
        return self._manager.__enter__()

    def __exit__(self, *raised: Any) -> bool | None:
        return self._manager.__exit__(*raised)

    if not TYPE_CHECKING:  # a type checker knows that there is none

        def __getattr__(self, name: str) -> Any:
            if name.startswith("_"):  # as copying and notebooks look for
                raise AttributeError(name)
            raise AttributeError(
                f"{self._call}() is opened by with, and has no {name} before: "
                f"with {self._call}(...) as opened: opened.{name}"
            )


def opened_by_with(function: Callable[Given, Iterator[T]]) -> Callable[Given, Opening[T]]:
    """Make a context manager of a generator function, as `contextmanager`, that says how it is used."""
    manage = contextmanager(function)

    @wraps(function)
    def call(*args: Given.args, **kwargs: Given.kwargs) -> Opening[T]:
        return Opening(manage(*args, **kwargs), function.__name__)

    return call
