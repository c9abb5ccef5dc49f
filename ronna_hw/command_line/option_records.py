"""Options that several commands share, declared once as the fields of a dataclass."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, get_type_hints

Returned = TypeVar("Returned")


def with_option_records(command: Callable[..., Returned]) -> Callable[..., Returned]:
    """The command as typer reads it: each parameter of a dataclass type is replaced by its fields.

    A field is declared like a parameter, `name: Annotated[type, typer.Option(...)] = default`. The command
    itself receives the record.
    """
    parameters = inspect.signature(command, eval_str=True).parameters
    records = {
        name: one.annotation
        for name, one in parameters.items()
        if isinstance(one.annotation, type) and is_dataclass(one.annotation)
    }

    def expanded() -> Iterator[inspect.Parameter]:
        for name, one in parameters.items():
            if name not in records:
                yield one.replace(kind=inspect.Parameter.KEYWORD_ONLY)
                continue
            types = get_type_hints(records[name], include_extras=True)
            for field in fields(records[name]):
                yield inspect.Parameter(
                    field.name,
                    inspect.Parameter.KEYWORD_ONLY,
                    default=field.default,
                    annotation=types[field.name],
                )

    @functools.wraps(command)
    def called(**given: Any) -> Returned:
        for name, record in records.items():
            given[name] = record(**{field.name: given.pop(field.name) for field in fields(record)})
        return command(**given)

    # What `inspect.signature`, and so typer, reads first; the type of a function does not declare it.
    called.__signature__ = inspect.Signature(list(expanded()))  # type: ignore[attr-defined]
    return called
