"""Cases of the suite for GigE Vision cameras: registers, control, features, stream."""

from __future__ import annotations

from conformance.gige import control_cases, feature_cases, register_cases, stream_cases
from conformance.gige.checklist import GIGE_CHECKLIST
from conformance.protocol import ProtocolCases


def simulator() -> tuple[str, ...]:
    """Arguments of `ronna-sim` for a simulated pair of cameras."""
    return ("basler",)


PROTOCOL = ProtocolCases(
    cases=(
        *register_cases.CASES.cases,
        *control_cases.CASES.cases,
        *feature_cases.CASES.cases,
        *stream_cases.CASES.cases,
    ),
    checklist=GIGE_CHECKLIST,
    simulator=simulator,
)
