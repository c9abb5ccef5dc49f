"""Errors raised by the studies."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, ConnectError, DataError, ErrorCode, RefusedError

OTHER_STUDY = ErrorCode(
    "STU-001",
    ConfigurationError,
    "The folder contains a study with different settings, or results of different code.",
    "Choose another --out, or use settings and code of the study in this folder.",
)


LEDGER_UNREADABLE = ErrorCode(
    "STU-002",
    DataError,
    "The ledger of finished units cannot be read.",
    "Choose another --out: the units in this folder cannot be distinguished from those of another study.",
)


SCHEDULER_UNREACHABLE = ErrorCode(
    "STU-003",
    ConnectError,
    "No Dask scheduler can be reached at this address.",
    "Start one with `dask scheduler`, or omit --scheduler to use this computer's cores.",
)


EXTRA_MISSING = ErrorCode(
    "STU-004",
    ConfigurationError,
    "An optional package needed for this option is not installed.",
    "Install it with: pip install 'ronna-hw[dask]'.",
)


UNIT_FAILED = ErrorCode(
    "STU-005",
    DataError,
    "A unit of the study raised an error.",
    "Run the study again: finished units are kept; --verbose shows the traceback.",
)


PHANTOM_FAILED = ErrorCode(
    "STU-006",
    DataError,
    "`ronna-sim phantom` failed to write a scan for the study.",
    "Run `ronna-sim phantom` with these arguments to see the reason.",
)


NOT_FOR_JUDGING = ErrorCode(
    "STU-007",
    ConfigurationError,
    "A phantom family reserved for tuning was selected for evaluating the localizer.",
    "Remove it from the evaluation families, or state its purpose in the phantom.",
)


TRACKER_NOT_SIMULATED = ErrorCode(
    "STU-008",
    DataError,
    "The simulated tracker failed to read the frame for the study.",
    "Run `ronna-sim polaris` and `ronna-sim scene` alone to see the reason.",
)


POSE_NOT_SOLVED = ErrorCode(
    "STU-009",
    DataError,
    "A random arm does not converge to a planned pose, which may be singular or out of reach.",
    "Use another --seed and report this one: the study plans its poses clear of singularities.",
)


NO_RUN_TO_TIME = ErrorCode(
    "STU-011",
    ConfigurationError,
    "A folder given to `times` is not a run folder.",
    "Give folders written by ronna-procedure run; ronna-procedure list shows them.",
)


PHANTOM_OUT_OF_REACH = ErrorCode(
    "STU-010",
    DataError,
    "The arm cannot reach the phantom at one of its positions.",
    "The positions are fixed: report the strategy and the trajectory.",
)


class MethodRefused(ConfigurationError):
    """A user method cannot be used: it is missing, of a different kind, or has the wrong signature."""

    code = "STU-012"
    action = "docs/how-to/research/own-methods.md shows one of each kind."


class MethodFailed(DataError):
    """A user method raised an error, or ended its process."""

    code = "STU-013"
    action = "Correct the method and start again; a study that was begun with it needs another --out."


class MethodAnswerWrong(DataError):
    """A user method returned an invalid result for its kind."""

    code = "STU-014"
    action = "Correct what it returns; docs/how-to/research/own-methods.md shows one of each kind."


WORLD_NOT_RUN = ErrorCode(
    "STU-015",
    DataError,
    "The case of a random world did not start, so there is nothing to judge.",
    "Repeat this world with --only to see the reason.",
)


NOTEBOOKS_NOT_INSTALLED = ErrorCode(
    "STU-016",
    ConfigurationError,
    "The packages that execute notebooks are not installed.",
    "Run make setup in the clone, or python -m pip install 'ronna-hw[notebooks]'.",
)


NOTEBOOK_FAILED = ErrorCode(
    "STU-017",
    DataError,
    "A cell of a notebook raised an error, took too long, or ended its kernel.",
    "Correct the cell, or take the example from examples/notebooks again.",
)


NOT_A_NOTEBOOK = ErrorCode(
    "STU-018",
    DataError,
    "A file given as a notebook is not one.",
    "Give one of examples/notebooks, or a notebook that Jupyter has written.",
)

SWEEP_IN_USE = ErrorCode(
    "STU-019",
    RefusedError,
    "Another sweep is writing its points into the folder.",
    "Wait until it has ended, and call again: its points are then taken over; or give another folder=.",
)

SERIES_WITHOUT_SCALE = ErrorCode(
    "STU-027",
    DataError,
    "Markers cannot be inserted into this series: too few slices, or voxels too large for a sphere.",
    "Give a series of a whole head with slices of at most 3 mm.",
)

SERIES_WITHOUT_ROOM = ErrorCode(
    "STU-028",
    DataError,
    "Markers cannot be inserted into this series: it shows no head with air around it.",
    "Give a CT of a head whose field of view is wider than the head by 40 mm on a side.",
)
