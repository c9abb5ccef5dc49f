"""Error hierarchy of the whole project.

    RonnaError
    +-- ConfigurationError   a file or an option is wrong; no device has been touched
    +-- DataError            an input (CT, plan, points) is wrong; also a ValueError
    +-- ConnectError         the device is absent, or it is a different one
    +-- ProtocolError        bytes that violate the protocol; the last ones are kept
    +-- LinkTimeout          no reply within its time limit; also a TimeoutError
    +-- DeviceError          the device itself reports a fault
    +-- LimitError           a limit of motion, range or safety was reached
    +-- StateError           the call is not allowed in the current state
    +-- RefusedError         a guard refused; says which preconditions are unmet

The errors of a package stand in its `errors.py`, each with a stable code such as `NDI-004`: an `ErrorCode`,
which is data, or a subclass where somebody catches it by name. The table of codes in the reference is
generated from them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeAlias, TypedDict, TypeVar, Unpack

from ronna_hw.text import printable

EXIT_DONE = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_REFUSED = 3
EXIT_NOT_FOUND = 4
EXIT_LINK_LOST = 5
EXIT_SAFETY_STOP = 6
EXIT_ABORTED = 7
EXIT_RECOVERY_NEEDED = 8
EXIT_UNCONFIRMED = 9  # of verify: intact as far as can be said
EXIT_INTERRUPTED = 130

AnyError = TypeVar("AnyError", bound="RonnaError", covariant=True)

LAST_BYTES_KEPT = 64  # enough for a whole short telegram, short enough for one line of hex


class ErrorWords(TypedDict, total=False):
    """Optional words of a `RonnaError`, as its raiser gives them."""

    expected: str | None
    limit: str | None
    got: str | None
    action: str | None
    wire: bytes


class RonnaError(Exception):
    """Base of all project errors: what happened, what was expected, the limit, and what to do.

    `code`, `action` and `exit_code` are attributes of the concrete class, or come from the `entry` of its
    package's table; the raiser supplies `what` and, if helpful, `expected`, `limit`, `got` and what to do
    instead of `action`. `page_action` is the part of `action` that is done without a command. `wire` keeps
    the last bytes of a protocol error.
    """

    code: str = ""
    action: str = ""
    page_action: str = ""  # nothing: all of `action`
    exit_code: int = EXIT_FAILED  # of an error that quotes a program: that program's

    def __init__(
        self,
        what: str,
        *,
        expected: str | None = None,
        limit: str | None = None,
        got: str | None = None,
        action: str | None = None,
        wire: bytes = b"",
        entry: ErrorCode[Any] | None = None,
    ) -> None:
        self.entry = entry
        meaning = (type(self).__doc__ or "").strip().partition("\n")[0]
        if entry is not None:
            meaning, self.code, self.exit_code = entry.meaning, entry.code, entry.exit_code
            self.action, self.page_action = entry.action, entry.page_action
        # Of the code in words, to go on in a sentence.
        self.meaning = f"{meaning[:1].lower()}{meaning[1:].rstrip('.')}"
        self.what = printable(what)
        self.expected = expected and printable(expected)
        self.limit = limit and printable(limit)
        self.got = got and printable(got)
        self.page_advice = printable(action or self.page_action or self.action)
        self.action = self.advice = printable(action or self.action)
        self.wire = bytes(wire[-LAST_BYTES_KEPT:])
        self.attachments: dict[str, str] = {}  # file name -> text: evidence for the run folder
        self.shown = False  # already, at the terminal, by a command that continued; not printed again
        self.run: Path | None = None  # the folder of the case that ended with it
        super().__init__(self._one_line())

    @property
    def summary(self) -> str:
        """Description of the error with its values, such as `no reply; expected OKAY, got ERROR01`.

        Without code and advice.
        """
        values = [
            f"{label} {value}"
            for label, value in (("expected", self.expected), ("limit", self.limit), ("got", self.got))
            if value
        ]
        if values == [f"got {self.got}"]:  # nothing to compare with: it explains what happened
            return f"{self.what}: {self.got}"
        return "; ".join(part for part in (self.what, ", ".join(values)) if part)

    def reworded(self, what: str, **words: Unpack[ErrorWords]) -> Self:
        """Return an error of the same code that says it in other words."""
        return type(self)(what, **words, entry=self.entry)

    def happened_during(self, doing: str) -> None:
        """Say during what it happened."""
        self.what = f"{self.what}, during {printable(doing)}"
        self.args = (self._one_line(),)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle by field, because rebuilding from the one-line message would duplicate every part."""
        return _restore_error, (type(self), self.args, vars(self))

    def _one_line(self) -> str:
        line = f"{self.code}: {self.summary}" if self.code else self.summary
        if self.wire:
            line = f"{line}; last bytes {self.wire.hex(' ')}"
        sentence = line if line.endswith("?") else f"{line.removesuffix('.')}."
        return f"{sentence} {self.advice}" if self.advice else line


def _restore_error(kind: type[RonnaError], line: tuple[str], content: dict[str, Any]) -> RonnaError:
    error = kind.__new__(kind, *line)
    error.args = line  # `OSError`, of which a time-out is one, takes them in its own constructor only
    vars(error).update(content)
    return error


class ConfigurationError(RonnaError):
    """A file or option is invalid."""

    exit_code = EXIT_USAGE


class DataError(RonnaError, ValueError):
    """Input data is invalid, such as a series, a plan or a point set."""


class ConnectError(RonnaError):
    """The device is absent, or is not the requested one."""

    exit_code = EXIT_NOT_FOUND


class ProtocolError(RonnaError):
    """Bytes on the wire violate the protocol."""

    exit_code = EXIT_LINK_LOST


class LinkTimeout(RonnaError, TimeoutError):
    """A reply did not arrive within its time limit."""

    exit_code = EXIT_LINK_LOST


class DeviceError(RonnaError):
    """The device reports a fault."""


class LimitError(RonnaError):
    """A limit of range, speed, reach or safety was exceeded."""

    exit_code = EXIT_SAFETY_STOP


class StateError(RonnaError):
    """A call is not allowed in the current lifecycle state."""


class RefusedError(RonnaError):
    """A guard refused an action."""

    exit_code = EXIT_REFUSED


@dataclass(frozen=True)
class ErrorCode(Generic[AnyError]):
    """Error that nobody catches by name: its code, kind, meaning and what to do, as one row of a table.

    Called as a class of errors would be: `raise WRONG_SERIES("...", got="...")`. By default it ends a program
    with the exit code of its kind.
    """

    code: str
    kind: type[AnyError]
    meaning: str
    action: str
    page_action: str = ""
    own_exit_code: int | None = None
    known: ClassVar[dict[str, ErrorCode[Any]]] = {}  # by code, as Python keeps the subclasses of a class

    def __post_init__(self) -> None:
        """Enter it among those known."""
        self.known[self.code] = self

    @property
    def exit_code(self) -> int:
        """Exit status of a program that ends with this error."""
        return self.kind.exit_code if self.own_exit_code is None else self.own_exit_code

    def __call__(self, what: str, **words: Unpack[ErrorWords]) -> AnyError:
        """Return the error that has happened; the parameters are those of `RonnaError`."""
        return self.kind(what, **words, entry=self)


AnyCode: TypeAlias = type[AnyError] | ErrorCode[AnyError]


def is_error(problem: BaseException, *expected: AnyCode[RonnaError] | type[BaseException]) -> bool:
    """Return whether a problem is one of these errors: of a class, or with the code of a row."""
    return any(
        isinstance(problem, one) if isinstance(one, type) else getattr(problem, "code", "") == one.code
        for one in expected
    )


def find_code(code: str) -> ErrorCode[RonnaError] | type[RonnaError] | None:
    """Return the error with a code among those of all imported modules, None if there is none."""
    if (row := ErrorCode.known.get(code)) is not None:
        return row
    return next((one for one in coded_classes() if one.code == code), None)


def summary_of(problem: Exception) -> str:
    """Summarise a project error, or a Python error with its class name."""
    return problem.summary if isinstance(problem, RonnaError) else f"{type(problem).__name__}: {problem}"


def coded_classes(root: type[RonnaError] = RonnaError) -> Iterator[type[RonnaError]]:
    """Yield every imported error class with a code of its own, in definition order."""
    for child in root.__subclasses__():
        if child.code and "code" in vars(child):
            yield child
        yield from coded_classes(child)
