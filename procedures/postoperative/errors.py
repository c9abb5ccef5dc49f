"""Errors of the check after the operation, POST-001 to POST-009."""

from __future__ import annotations

from ronna_hw.errors import EXIT_REFUSED, DataError


class NoBone(DataError):
    """A CT shows no skull to lay the other one over."""

    code = "POST-001"
    action = "Give CTs of the whole head, in Hounsfield units."


class HeadsDiffer(DataError):
    """The skulls of the two CTs do not fit each other."""

    code = "POST-002"
    action = "Check that both series are of this patient and show the same part of the head."
    exit_code = EXIT_REFUSED


class SeriesSwapped(DataError):
    """The plan belongs to the CT that was given as the one after the operation."""

    code = "POST-003"
    action = "Give the CT that was planned on first, then the one after the operation."


class OneSeriesTwice(DataError):
    """Both folders hold the same series."""

    code = "POST-004"
    action = "Give the CT that was planned on, then the one taken after the operation."


class OtherPatient(DataError):
    """The two CTs bear different patient identifiers."""

    code = "POST-005"
    action = "Stop and find out whose CT each is; nothing was compared."
    exit_code = EXIT_REFUSED


class InstrumentMissing(DataError):
    """Along a trajectory the CT shows neither an instrument nor a drilled hole."""

    code = "POST-006"
    action = "Look at the CT; name the trajectories that were done with --only."
    exit_code = EXIT_REFUSED


class InstrumentAmbiguous(DataError):
    """One instrument, or one hole, lies along more than one trajectory."""

    code = "POST-007"
    action = "Look at the CT which trajectory it was; name the ones that were done with --only."
    exit_code = EXIT_REFUSED


class RunOfAnotherCt(DataError):
    """The run to whose report the result should go followed a plan on another CT."""

    code = "POST-008"
    action = "Give the run of this operation, or leave --run out."


class FitFailed(DataError):
    """What was found along a trajectory is neither a straight rod nor a round hole: its axis is not known."""

    code = "POST-009"
    action = "Look at the CT there: a bent lead, a larger opening? Leave that trajectory out with --only."
    exit_code = EXIT_REFUSED
