"""Errors raised by the studies."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, ConnectError, DataError


class OtherStudy(ConfigurationError):
    """The folder contains a study with different settings, or results of different code."""

    code = "STU-001"
    action = "Choose another --out, or use settings and code of the study in this folder."


class LedgerUnreadable(DataError):
    """The ledger of finished units cannot be read."""

    code = "STU-002"
    action = (
        "Choose another --out: the units in this folder cannot be distinguished from those of another study."
    )


class SchedulerUnreachable(ConnectError):
    """No Dask scheduler can be reached at this address."""

    code = "STU-003"
    action = "Start one with `dask scheduler`, or omit --scheduler to use this computer's cores."


class ExtraMissing(ConfigurationError):
    """An optional package needed for this option is not installed."""

    code = "STU-004"
    action = "Install it with: pip install 'ronna-hw[dask]'."


class UnitFailed(DataError):
    """A unit of the study raised an error."""

    code = "STU-005"
    action = "Run the study again: finished units are kept; --verbose shows the traceback."


class PhantomFailed(DataError):
    """`ronna-sim phantom` failed to write a scan for the study."""

    code = "STU-006"
    action = "Run `ronna-sim phantom` with these arguments to see the reason."


class NotForJudging(ConfigurationError):
    """A phantom family reserved for tuning was selected for evaluating the localizer."""

    code = "STU-007"
    action = "Remove it from the evaluation families, or state its purpose in the phantom."


class TrackerNotSimulated(DataError):
    """The simulated tracker failed to read the frame for the study."""

    code = "STU-008"
    action = "Run `ronna-sim polaris` and `ronna-sim scene` alone to see the reason."


class PoseNotSolved(DataError):
    """A random arm does not converge to a planned pose, which may be singular or out of reach."""

    code = "STU-009"
    action = "Use another --seed and report this one: the study plans its poses clear of singularities."


class NoRunToTime(ConfigurationError):
    """A folder given to `times` is not a run folder."""

    code = "STU-011"
    action = "Give folders written by ronna-procedure run; ronna-procedure list shows them."


class PhantomOutOfReach(DataError):
    """The arm cannot reach the phantom at one of its positions."""

    code = "STU-010"
    action = "The positions are fixed: report the strategy and the trajectory."


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


class WorldNotRun(DataError):
    """The case of a random world did not start, so there is nothing to judge."""

    code = "STU-015"
    action = "Repeat this world with --only to see the reason."


class NotebooksNotInstalled(ConfigurationError):
    """The packages that execute notebooks are not installed."""

    code = "STU-016"
    action = "Run make setup in the clone, or python -m pip install 'ronna-hw[notebooks]'."


class NotebookFailed(DataError):
    """A cell of a notebook raised an error, took too long, or ended its kernel."""

    code = "STU-017"
    action = "Correct the cell, or take the example from examples/notebooks again."


class NotANotebook(DataError):
    """A file given as a notebook is not one."""

    code = "STU-018"
    action = "Give one of examples/notebooks, or a notebook that Jupyter has written."
