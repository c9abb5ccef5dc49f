"""Errors in the postoperative check, POST-001 to POST-009."""

from __future__ import annotations

from ronna_hw.errors import EXIT_REFUSED, DataError, ErrorCode

NO_BONE = ErrorCode(
    "POST-001",
    DataError,
    "A CT shows no skull for registration.",
    "Give CTs of the whole head, in Hounsfield units.",
)


HEADS_DIFFER = ErrorCode(
    "POST-002",
    DataError,
    "The skulls of the two CTs do not match.",
    "Check that both series are of this patient and show the same part of the head.",
    own_exit_code=EXIT_REFUSED,
)


SERIES_SWAPPED = ErrorCode(
    "POST-003",
    DataError,
    "The plan belongs to the CT that was given as postoperative.",
    "Give the planning CT first, then the postoperative one.",
)


ONE_SERIES_TWICE = ErrorCode(
    "POST-004",
    DataError,
    "Both folders contain the same series.",
    "Give the planning CT, then the postoperative one.",
)


OTHER_PATIENT = ErrorCode(
    "POST-005",
    DataError,
    "The two CTs have different patient identifiers.",
    "Stop and find out whose CT each is; nothing was compared.",
    own_exit_code=EXIT_REFUSED,
)


INSTRUMENT_MISSING = ErrorCode(
    "POST-006",
    DataError,
    "The CT shows neither an instrument nor a drilled hole along a trajectory.",
    "Check that the CT reaches that far; name the trajectories that were carried out with --only.",
    own_exit_code=EXIT_REFUSED,
)


INSTRUMENT_AMBIGUOUS = ErrorCode(
    "POST-007",
    DataError,
    "The same instrument or hole was found along more than one trajectory.",
    "Check the CT to see which trajectory it was; name the ones that were carried out with --only.",
    own_exit_code=EXIT_REFUSED,
)


RUN_OF_ANOTHER_PLAN = ErrorCode(
    "POST-008",
    DataError,
    "The run to be reported on used another plan, or a plan on another CT.",
    "Give the run of this operation, or omit --run.",
)


FIT_FAILED = ErrorCode(
    "POST-009",
    DataError,
    "The object along a trajectory does not fit a rod or a round hole, so its axis is unknown.",
    "Check the CT there: a bent lead, a larger opening? Leave that trajectory out with --only.",
    own_exit_code=EXIT_REFUSED,
)
