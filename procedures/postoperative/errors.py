"""Errors in the postoperative check, POST-001 to POST-009."""

from __future__ import annotations

from ronna_hw.errors import EXIT_REFUSED, DataError


class NoBone(DataError):
    """A CT shows no skull for registration."""

    code = "POST-001"
    action = "Give CTs of the whole head, in Hounsfield units."


class HeadsDiffer(DataError):
    """The skulls of the two CTs do not match."""

    code = "POST-002"
    action = "Check that both series are of this patient and show the same part of the head."
    exit_code = EXIT_REFUSED


class SeriesSwapped(DataError):
    """The plan belongs to the CT that was given as postoperative."""

    code = "POST-003"
    action = "Give the planning CT first, then the postoperative one."


class OneSeriesTwice(DataError):
    """Both folders contain the same series."""

    code = "POST-004"
    action = "Give the planning CT, then the postoperative one."


class OtherPatient(DataError):
    """The two CTs have different patient identifiers."""

    code = "POST-005"
    action = "Stop and find out whose CT each is; nothing was compared."
    exit_code = EXIT_REFUSED


class InstrumentMissing(DataError):
    """The CT shows neither an instrument nor a drilled hole along a trajectory."""

    code = "POST-006"
    action = "Check that the CT reaches that far; name the trajectories that were carried out with --only."
    exit_code = EXIT_REFUSED


class InstrumentAmbiguous(DataError):
    """The same instrument or hole was found along more than one trajectory."""

    code = "POST-007"
    action = "Check the CT to see which trajectory it was; name the ones that were carried out with --only."
    exit_code = EXIT_REFUSED


class RunOfAnotherPlan(DataError):
    """The run to be reported on used another plan, or a plan on another CT."""

    code = "POST-008"
    action = "Give the run of this operation, or omit --run."


class FitFailed(DataError):
    """The object along a trajectory does not fit a rod or a round hole, so its axis is unknown."""

    code = "POST-009"
    action = "Check the CT there: a bent lead, a larger opening? Leave that trajectory out with --only."
    exit_code = EXIT_REFUSED
