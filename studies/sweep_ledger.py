"""Finished points of a sweep: in this process, and with a folder one line of JSON each.

What goes into a folder has to mean the same in the next process. A lambda, a function inside another and a
method of an object do not: two of them may share a name and a text, and differ in what they remember.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable, Mapping
from functools import partial
from inspect import getsource
from operator import attrgetter
from pathlib import Path
from typing import Any

from ronna_hw.arguments import WrongArgument, show
from ronna_hw.bounded_input import parse_json, read_json_lines
from ronna_hw.command_line.messages import tell
from studies.campaign.folder import code
from studies.errors import LEDGER_UNREADABLE, OTHER_STUDY

FILE = "points.jsonl"  # of finished points, below a line that says which function they are of
NAMED = "Write it with def at the top of a module, a script or a notebook cell"
Row = dict[str, Any]


class SweepLedger:
    """Finished points of a function."""

    def __init__(self, folder: Path | None, function: Callable[..., Any]) -> None:
        """Open or create the ledger. Without a folder nothing is kept.

        Points of damaged lines are run again. Raises ARG-001 for a function that the next process could not
        tell from another, STU-001 for points of another function or code, STU-002 if they are unreadable.
        """
        self._rows: dict[str, list[Row]] = {}
        self._path = None if folder is None else folder / FILE
        if folder is None or self._path is None:
            return
        if not has_own_name(function):
            raise WrongArgument(
                "a sweep with a folder needs a function that has a name of its own, and remembers nothing",
                got=show(function),
                action=f"{NAMED}; what it needs is an argument of the sweep too.",
            )
        head = {"function": name_of(function), "code": _code_of(function)}
        if not self._path.stat().st_size:
            self._append(head)
            return
        content = read_json_lines(self._path)
        whole = content[: content.rfind(b"\n") + 1]  # the last line may be cut
        first, *lines = whole.splitlines() or [b""]
        try:
            there = parse_json(first)
            if there != head:
                raise OTHER_STUDY(
                    f"{folder} has points of {there.get('function')} or of other code",
                    action="Give another folder=, or remove this one.",
                )
        except (ValueError, TypeError, AttributeError) as error:
            raise LEDGER_UNREADABLE(
                f"{self._path}: {error}", action="Give another folder=, or remove this one."
            ) from error
        os.truncate(self._path, len(whole))
        damaged = 0
        for line in lines:
            try:
                finished = parse_json(line)
                self._rows[finished["point"]] = finished["rows"]
            except (ValueError, KeyError, TypeError):
                damaged += 1
        if damaged:
            tell(f"{damaged} of {len(lines)} lines of {self._path} are damaged: their points run again")

    def find(self, point: Row) -> list[Row] | None:
        """Return the rows of a point, or None if it is not finished."""
        return self._rows.get(self._key(point))

    def add(self, point: Row, rows: list[Row], *, keep: bool) -> None:
        """Add the rows of a finished point; `keep` writes them into the folder too."""
        key = self._key(point)
        self._rows[key] = rows
        if keep and self._path is not None:
            self._append({"point": key, "rows": rows})

    def _append(self, line: Mapping[str, object]) -> None:
        assert self._path is not None, "there is a folder"
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    def _key(self, point: Row) -> str:
        """Return the text that names a point. Raises ARG-001 for an argument that no text can name."""
        return ", ".join(f"{name}={self._text_of(name, point[name])}" for name in sorted(point))

    def _text_of(self, argument: str, value: object) -> str:
        try:
            return json.dumps(value, sort_keys=True, default=partial(self._name, argument))
        except WrongArgument:
            raise
        except (TypeError, ValueError) as error:  # keys that are no text, or a list that holds itself
            raise _unnamed(argument, value) from error

    def _name(self, argument: str, value: object) -> str:
        if isinstance(value, os.PathLike):
            return str(value)
        if not callable(value):
            raise _unnamed(argument, value)
        if has_own_name(value):
            return name_of(value)
        if self._path is None:
            return f"{name_of(value)} {id(value)}"  # the points hold it, so no other has its number
        raise WrongArgument(
            f"{argument} is a function without a name of its own, which a folder cannot tell from another",
            expected="a function that has one, and remembers nothing",
            got=show(value),
            action=f"{NAMED}, or sweep without folder=.",
        )


def _unnamed(argument: str, value: object) -> WrongArgument:
    return WrongArgument(
        f"a sweep cannot name {argument}",
        expected="text, numbers, lists of them or a function",
        got=show(value),
        action=f"Make a list of it, as in {argument}=list(...), or give what it is made from.",
    )


def has_own_name(function: Callable[..., Any]) -> bool:
    """Return whether the function is what its module has under its name: no lambda, closure or method."""
    home = sys.modules.get(getattr(function, "__module__", None) or "")
    try:
        return bool(attrgetter(function.__qualname__)(home) == function)
    except AttributeError:
        return False


def name_of(function: Callable[..., Any]) -> str:
    """Return the full name of a function, or its repr for other callables."""
    name = getattr(function, "__qualname__", None) or repr(function)
    return f"{getattr(function, '__module__', None)}.{name}"


def _code_of(function: Callable[..., Any]) -> str:
    """Return a hash of the program and of the function's own lines, where they can be found."""
    try:
        own = getsource(function)
    except (OSError, TypeError):  # typed at a prompt
        own = ""
    return f"{code()}, {hashlib.sha256(own.encode()).hexdigest()[:16]}"
