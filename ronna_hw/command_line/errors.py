"""Errors around a command: usage, disk, paths, ports, and program faults."""

from __future__ import annotations

import errno
import os

from ronna_hw.errors import EXIT_USAGE, RonnaError


class UsageMistake(RonnaError):
    """The command line itself is wrong."""

    code = "CLI-001"
    action = "Run the command with --help."
    exit_code = EXIT_USAGE


class InternalFault(RonnaError):
    """An unexpected error in the program."""

    code = "CLI-002"
    action = "This is a bug: run again with --verbose and report the traceback."


class DiskFull(RonnaError):
    """No space is left, or the quota is used up."""

    code = "CLI-003"
    action = (
        "Free some space or choose another folder; this file was not written, earlier files are complete."
    )


class NotWritable(RonnaError):
    """This user may not read or write a file or folder."""

    code = "CLI-004"
    action = "Choose another folder, or change its permissions."


class PathProblem(RonnaError):
    """A path does not exist, or is a file where a folder is needed, or vice versa."""

    code = "CLI-005"
    action = "Check the path."


class PortInUse(RonnaError):
    """Another program uses the network port."""

    code = "CLI-006"
    action = "Stop the other program or choose another endpoint."


class SystemRefused(RonnaError):
    """The operating system refused for another reason."""

    code = "CLI-007"
    action = "Fix what the system reports and run the command again."


class OutOfMemory(RonnaError):
    """The computer ran out of memory."""

    code = "CLI-008"
    action = "Close other programs, or use a smaller series."


NOT_MAPPED = "failed to map segment"  # the loader's words for a library for which there is no memory
_BY_ERRNO: dict[int, type[RonnaError]] = {
    errno.ENOSPC: DiskFull,
    errno.EDQUOT: DiskFull,
    errno.EFBIG: DiskFull,
    errno.EACCES: NotWritable,
    errno.EPERM: NotWritable,
    errno.EROFS: NotWritable,
    errno.ENOENT: PathProblem,
    errno.ENOTDIR: PathProblem,
    errno.EISDIR: PathProblem,
    errno.EEXIST: PathProblem,
    errno.ENAMETOOLONG: PathProblem,
    errno.EADDRINUSE: PortInUse,
    errno.ENOMEM: OutOfMemory,
}


def as_ronna_error(problem: BaseException) -> RonnaError:
    """Any exception as a RonnaError: itself, or an operating-system or internal error with a code."""
    if isinstance(problem, RonnaError):
        return problem
    if isinstance(problem, MemoryError) or (isinstance(problem, ImportError) and NOT_MAPPED in str(problem)):
        return OutOfMemory("the computer ran out of memory")
    problem = _first_with_number(problem)
    if isinstance(problem, OSError) and problem.errno is not None:
        kind = _BY_ERRNO.get(problem.errno, SystemRefused)
        reason = os.strerror(problem.errno).lower()
        places = [str(name) for name in (problem.filename, problem.filename2) if name is not None]
        return kind(f"{' and '.join(places)}: {reason}" if places else reason)
    return InternalFault(f"{type(problem).__name__}: {problem}")


def _first_with_number(problem: BaseException) -> BaseException:
    """The operating-system error wrapped by a library."""
    inner: BaseException | None = problem
    while inner is not None:
        if isinstance(inner, OSError) and inner.errno is not None:
            return inner
        inner = inner.__cause__ or inner.__context__
    return problem
