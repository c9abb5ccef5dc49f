"""Errors of the command line: usage, disk, paths, ports, memory, and program faults.

Typer reports half of a mistake in a command line. The other half, such as the closest valid word, is in the
option and in its validation error.
"""

from __future__ import annotations

import errno
import itertools
import os
import pwd
import re
import resource
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from ronna_hw.errors import EXIT_USAGE, ErrorCode, ErrorWords, RonnaError
from ronna_hw.near_names import did_you_mean, find_near
from ronna_hw.text import unit_of


class UsageMistake(RonnaError):
    """The command line is invalid."""

    code = "CLI-001"
    action = "Run the command with --help."
    exit_code = EXIT_USAGE


INTERNAL_FAULT = ErrorCode(
    "CLI-002",
    RonnaError,
    "The program encountered an unexpected error.",
    "This is a bug: run again with --verbose and report the traceback.",
)


DISK_FULL = ErrorCode(
    "CLI-003",
    RonnaError,
    "The disk is full, or the quota is exhausted.",
    "Free some space or choose another folder; this file was not written, earlier files are complete.",
)


NOT_WRITABLE = ErrorCode(
    "CLI-004",
    RonnaError,
    "The current user lacks permission to read or write a file or folder.",
    "Choose another folder, or change its permissions.",
)


PATH_PROBLEM = ErrorCode(
    "CLI-005",
    RonnaError,
    "A path does not exist, or is a file instead of a folder or vice versa.",
    "Check the path.",
)


PORT_IN_USE = ErrorCode(
    "CLI-006",
    RonnaError,
    "The network port is already in use by another program.",
    "Stop the other program or choose another endpoint.",
)


SYSTEM_REFUSED = ErrorCode(
    "CLI-007",
    RonnaError,
    "The operating system refused an operation for another reason.",
    "Fix what the system reports and run the command again.",
)


OUT_OF_MEMORY = ErrorCode(
    "CLI-008", RonnaError, "The computer ran out of memory.", "Close other programs, or use a smaller series."
)


PAGES_MISSING = ErrorCode(
    "CLI-009",
    RonnaError,
    "The command opens pages in the browser, and the packages for them are not installed.",
    "Run make setup in the clone, or in its environment: pip install 'ronna-hw[console]'.",
    own_exit_code=EXIT_USAGE,
)
CONSOLE_MODULES = ("fastapi", "nicegui", "skimage", "starlette", "uvicorn")  # of the extra `console`
LONGEST_FILE_NAME = 255  # bytes, of Linux file systems
NOT_MAPPED = "failed to map segment"  # the loader's words for a library for which there is no memory
_BY_ERRNO: dict[int, ErrorCode[RonnaError]] = {
    errno.ENOSPC: DISK_FULL,
    errno.EDQUOT: DISK_FULL,
    errno.EFBIG: DISK_FULL,
    errno.EACCES: NOT_WRITABLE,
    errno.EPERM: NOT_WRITABLE,
    errno.EROFS: NOT_WRITABLE,
    errno.ENOENT: PATH_PROBLEM,
    errno.ENOTDIR: PATH_PROBLEM,
    errno.EISDIR: PATH_PROBLEM,
    errno.EEXIST: PATH_PROBLEM,
    errno.ENAMETOOLONG: PATH_PROBLEM,
    errno.EADDRINUSE: PORT_IN_USE,
    errno.ENOMEM: OUT_OF_MEMORY,
}


def as_ronna_error(problem: BaseException) -> RonnaError:
    """Convert any exception to a RonnaError, assigning codes to system and program errors."""
    if isinstance(problem, RonnaError):
        return problem
    if isinstance(problem, MemoryError) or (isinstance(problem, ImportError) and NOT_MAPPED in str(problem)):
        return OUT_OF_MEMORY("the computer ran out of memory")
    if isinstance(problem, ModuleNotFoundError) and problem.name in CONSOLE_MODULES:
        return PAGES_MISSING(f"this command needs {problem.name}, which is not installed")
    problem = _find_system_error(problem)
    if isinstance(problem, OSError) and problem.errno is not None:
        kind = _BY_ERRNO.get(problem.errno, SYSTEM_REFUSED)
        reason = os.strerror(problem.errno).lower()
        places = [str(name) for name in (problem.filename, problem.filename2) if name is not None]
        what = f"{' and '.join(places)}: {reason}" if places else reason
        return kind(what, **_explain_system_error(problem.errno))
    return INTERNAL_FAULT(f"{type(problem).__name__}: {problem}")


def _explain_system_error(number: int) -> ErrorWords:
    """Return what the system expected, and what to do where the advice of the code does not fit."""
    match number:
        case errno.ENOENT:
            return {"expected": "an existing file or folder"}
        case errno.EACCES | errno.EPERM:
            account = _name_account(os.geteuid())
            return {"expected": f"the right of account {account} to read it, or to write there"}
        case errno.EFBIG:
            largest = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
            if largest != resource.RLIM_INFINITY:
                action = "Raise it with ulimit -f in this shell, or LimitFSIZE of the service."
                return {"limit": f"{largest} bytes for a file", "action": action}
        case errno.ENAMETOOLONG:
            limit = f"{LONGEST_FILE_NAME} bytes for each name"
            return {"limit": limit, "action": "Choose a shorter name."}
    return {}


def _find_system_error(problem: BaseException) -> BaseException:
    """Return the operating-system error wrapped by a library's exception."""
    inner: BaseException | None = problem
    while inner is not None:
        if isinstance(inner, OSError) and inner.errno is not None:
            return inner
        inner = inner.__cause__ or (None if inner.__suppress_context__ else inner.__context__)
    return problem


MOST_ALIKE = 3  # suggestions
_UNREADABLE = re.compile(r"'(.+)' is not readable")
_FEW_VALUES = re.compile(r"(\d+) arguments")
_QUOTED = re.compile(r"'([^']+)'")  # words of a list of choices
_EXTRA = re.compile(r"Got unexpected extra argument(?:s|\(s\))? \((.*)\)")


def find_selected_command(command: Any, arguments: Sequence[str]) -> tuple[str, Sequence[Any]]:
    """Return name and parameters of the command selected by the arguments."""
    names = [str(command.name)]
    for word in arguments:
        if (inner := getattr(command, "commands", {}).get(word)) is None:
            break
        command = inner
        names.append(word)
    return " ".join(names), command.params


def convert_usage_error(
    mistake: Exception, command: str, parameters: Sequence[Any] = (), arguments: Sequence[str] = ()
) -> UsageMistake:
    """Convert a typer usage error to a UsageMistake: option, value, expectation, help."""
    context = getattr(mistake, "ctx", None)
    help_of = f"{command if context is None else context.command_path} --help"
    see = f"See {help_of}."
    if hasattr(mistake, "option_name") and hasattr(mistake, "possibilities"):
        return _unknown_option(str(mistake.option_name), context, help_of)
    parameter = getattr(mistake, "param", None)
    reason = _read_validation(mistake.__cause__, parameter)
    if parameter is not None and reason is not None:
        expected, got = reason
        what = f"{format_parameter(parameter)} cannot be {got}"
        near = did_you_mean(got.strip("'"), _QUOTED.findall(expected))
        explained = _explain(parameter, context, see)
        return UsageMistake(what, expected=expected, action=f"{near} {explained}".lstrip())
    if type(mistake).__name__ == "BadOptionUsage":  # too few values
        text = str(getattr(mistake, "message", "")).replace("Option ", "").replace("'", "").rstrip(".")
        named = (one for one in parameters if getattr(mistake, "option_name", "") in one.opts)
        meant = next((f"{one.metavar or one.opts[0]}: {one.help} " for one in named), "")
        text = _FEW_VALUES.sub(r"\1 values, separated by spaces", text).replace("an argument", "a value")
        if given := _values_after(getattr(mistake, "option_name", ""), arguments):
            text += f"; got {given}"
        return UsageMistake(text, action=f"{meant}{see}")
    if not (message := getattr(mistake, "message", "")):
        message = str(mistake.format_message() if hasattr(mistake, "format_message") else mistake)
    if found := _EXTRA.match(message):
        if swallowed := _find_swallowed_option(parameters, arguments):
            option, value = swallowed
            return UsageMistake(
                f"{option} has no value: {value!r} follows it",
                action=f"Is the variable for its value empty, as in a new terminal? {see}",
            )
        repeat = _advise_several_values(parameters)
        from ronna_hw.evidence.journal_reading import JOURNAL_FILE

        runs = [word for word in arguments if os.path.exists(os.path.join(word, JOURNAL_FILE))]
        if len(runs) > 1:
            return UsageMistake(
                f"{len(runs)} runs are given: {', '.join(map(shlex.quote, runs))}",
                expected="one",
                action=f"A pattern such as * stands for all that fit: name one. {see}",
            )
        there = [word for word in found[1].split() if os.path.exists(word)]
        if len(there) == 1 and os.path.exists(os.path.join(there[0], JOURNAL_FILE)):
            repeat = f"To go on with this run: ronna-procedure resume {shlex.quote(there[0])}. "
        elif there:
            repeat = "A pattern such as * may stand for several files or folders: name one. "
        return UsageMistake(f"unexpected on this command line: {found[1]!r}", action=f"{repeat}{see}")
    if parameter is not None and type(mistake).__name__ == "MissingParameter":
        what = f"{format_parameter(parameter)} is missing"
        return UsageMistake(what, action=_explain(parameter, context, see))
    if found := _UNREADABLE.search(message):
        what = f"{found[1]}: {_name_account(os.geteuid())} may not read it"
        return UsageMistake(what, action=f"{_advise_rights(found[1])}. {see}")
    hint = getattr(mistake, "param_hint", None)
    text = f"{hint}: {message}" if hint else message
    return UsageMistake(text if text.endswith("...") else text.rstrip("."), action=see)


def _find_swallowed_option(parameters: Sequence[Any], arguments: Sequence[str]) -> tuple[str, str] | None:
    """Return an option that has taken the next option as its value, as it does for an empty variable."""
    known = {name: one for one in parameters if one.param_type_name == "option" for name in one.opts}
    for word, following in itertools.pairwise(arguments):
        if word in known and not known[word].is_flag and following in known:
            return word, following
    return None


def _values_after(option: str, arguments: Sequence[str]) -> str:
    """Return what follows an option on a command line: too few values, as far as there are any."""
    return " ".join(arguments[arguments.index(option) + 1 :]) if option in arguments else ""


def _advise_several_values(parameters: Sequence[Any]) -> str:
    """Say which options of the command itself take several values, and how."""
    own = [one for one in parameters if one.param_type_name == "option" and one.expose_value]
    together = [f"{one.opts[0]} {one.metavar or ''}".rstrip() for one in own if one.nargs > 1]
    repeated = [one.opts[0] for one in own if one.multiple]
    ways = f"Several values follow their option: {', '.join(together)}. " if together else ""
    return ways + (f"To give several values, repeat the option: {', '.join(repeated)}. " if repeated else "")


def _advise_rights(path: str) -> str:
    """Say how a file or folder becomes readable: by its owner, and never for everybody."""
    owner, place = os.stat(path).st_uid, shlex.quote(path)
    if owner == os.geteuid():
        return f"It is yours: chmod -R u+rX {place}"
    name = _name_account(owner)
    return f"It belongs to {name}: run as {name}, or have a group of yours read it: chmod -R g+rX {place}"


def _name_account(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:  # of another computer or container
        return f"user {number}"


def _unknown_option(name: str, context: Any, help_of: str) -> UsageMistake:
    parameters = () if context is None else context.command.params
    known = (option for one in parameters for option in one.opts)
    words = [option.removeprefix("--") for option in known if option.startswith("--")]
    close_matches = find_near(name.removeprefix("--"), words, MOST_ALIKE)
    meant = f"Did you mean {' or '.join(f'--{word}' for word in close_matches)}? " if close_matches else ""
    return UsageMistake(f"unknown option {name}", action=f"{meant}{help_of} lists all options.")


def _read_validation(cause: BaseException | None, parameter: Any) -> tuple[str, str] | None:
    """Return the expected and actual values of a failed validation, or None for other errors."""
    unit = _format_unit(parameter)
    if (errors := getattr(cause, "errors", None)) is None:
        return None
    first: Mapping[str, Any] = errors()[0]
    limits: Mapping[str, Any] = first.get("ctx", {})
    match first["type"]:
        case "greater_than_equal":
            expected = f"at least {limits['ge']:g}{unit}"
        case "less_than_equal":
            expected = f"at most {limits['le']:g}{unit}"
        case "int_parsing" | "int_from_float" | "int_parsing_size":
            expected = "a whole number"
        case "float_parsing":
            expected = "a number"
        case _:  # one of several words, or something else a type refuses
            expected = str(first["msg"]).removeprefix("Value error, ").rstrip(".")
            expected = expected.partition(" is not ")[2] or expected
    return expected, repr(first["input"])


def _format_unit(parameter: Any) -> str:
    """Return the unit of an option after a space, by its name or placeholder; empty without one."""
    names = (*getattr(parameter, "opts", ()), getattr(parameter, "metavar", None) or "")
    return next((f" {unit}" for unit in map(unit_of, names) if unit), "")


def format_parameter(parameter: Any) -> str:
    """Format an option or argument as typed."""
    return str(parameter.get_error_hint()).replace("'", "").split(" (")[0]


def _explain(parameter: Any, context: Any, see: str) -> str:
    """Return the help of an option or argument, with its limits, and where to see more."""
    record = parameter.get_help_record(context)
    text = " ".join(str(record[1] if record else "").replace("[required]", "").split())
    end = "" if not text or text.endswith((".", "]")) else "."
    return f"{text}{end} {see}".lstrip()
