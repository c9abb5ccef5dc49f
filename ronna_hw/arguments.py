"""Checks of what callers give: paths, numbers and their shapes, refused in one line that shows the value."""

from __future__ import annotations

import math
import os
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING

from ronna_hw.errors import EXIT_USAGE, AnyCode, DataError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

REAL_KINDS = "iuf"  # of a NumPy type: signed, unsigned, floating
LONGEST_SHOWN = 60  # characters of a value


class WrongArgument(DataError, TypeError):
    """A function or a command was given an empty path, or an argument of the wrong type, shape or range."""

    code = "ARG-001"
    action = "Give what is expected; help() of the function describes its arguments."
    exit_code = EXIT_USAGE


def require_path(given: object, what: str) -> Path:
    """Return a path given as text or path. Raises ARG-001 for an empty one, and for anything else."""
    text = os.fspath(given) if isinstance(given, str | os.PathLike) else None
    if not isinstance(text, str):
        raise WrongArgument(f"{what} is no path", expected="a str or a Path", got=show(given))
    if not text.strip():
        raise WrongArgument(
            f"{what} is empty",
            expected="a path, or . for the current folder",
            got=repr(text),
            action="Check the variable that it comes from: it may be unset.",
        )
    return Path(text)


def require_duration_s(given: object, what: str) -> float:
    """Return a duration in seconds. Raises ARG-001 for anything but a finite number above zero."""
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0.0 < given < math.inf:
        raise WrongArgument(f"{what} is no duration", expected="seconds, above 0", got=show(given))
    return float(given)


def require_seed(given: object) -> int:
    """Return the seed of a simulated theatre. Raises ARG-001 for anything but a whole number from 0."""
    if isinstance(given, bool) or not isinstance(given, int) or given < 0:
        raise WrongArgument("the seed cannot be used", expected="a whole number, at least 0", got=show(given))
    return given


def require_numbers(
    given: object,
    what: str,
    *,
    shape: tuple[int, ...] | None = None,
    mistake: AnyCode[DataError] = WrongArgument,
) -> NDArray[np.float64]:
    """Return a new float array; raises `mistake` for anything else than real numbers, or another shape.

    Complex numbers, booleans, strings and objects are refused. Numbers need not be finite.
    """
    import numpy as np  # not for processes that check paths and counts only

    try:
        array = np.asarray(given)
    except (TypeError, ValueError) as error:
        raise mistake(f"{what} are not an array of numbers", got=show(given)) from error
    if array.dtype.kind not in REAL_KINDS:
        raise mistake(f"{what} are not real numbers", expected="integers or floats", got=show(given))
    if shape is not None and array.shape != shape:
        raise mistake(f"{what} have shape {array.shape}", expected=f"shape {shape}", got=show(given))
    return np.array(array, dtype=float)


def require_number(given: object, what: str) -> float:
    """Return a finite number. Raises ARG-001 for anything else, also for a boolean."""
    if isinstance(given, bool) or not isinstance(given, Real) or not math.isfinite(given):
        raise WrongArgument(f"{what} is no number", expected="a finite number", got=show(given))
    return float(given)


def require_time_s(given: object, what: str) -> float:
    """Return a time limit in seconds. Raises ARG-001 unless it is a number above 0."""
    if (time_s := require_number(given, what)) <= 0.0:
        raise WrongArgument(f"{what} is no time", expected="seconds, more than 0", got=show(given))
    return time_s


def show(value: object) -> str:
    """Show a value in a message: short ones as written, others by type and beginning."""
    text = " ".join(repr(value).split())
    return text if len(text) <= LONGEST_SHOWN else f"{type(value).__name__} {text[:LONGEST_SHOWN]}..."
