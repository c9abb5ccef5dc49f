"""Insertion by the assistant: what it relies on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from procedures.engine.context import StepContext
from procedures.journal.errors import GateFailed
from procedures.operator.question import NO, YES
from procedures.steps.clinical.assisted_insertion import _require_bases

BASES = object()


def context_after_a_fault(answer: str, kept: list[Any]) -> StepContext:
    fields = {
        "result_among": lambda _model, pick: pick([BASES]),
        "doubt": lambda _model: "URD-030: protective stop",
        "choose": lambda _question: answer,
        "keep": kept.append,
        "trajectory": "T1",
    }
    return cast("StepContext", SimpleNamespace(**fields))


@pytest.mark.hazard(59)
@pytest.mark.branch("KEPT_BASES")
def test_bases_from_before_a_fault_lead_no_instrument_unless_they_are_kept() -> None:
    kept: list[Any] = []
    with pytest.raises(GateFailed, match="older than a fault of an arm"):
        _require_bases(context_after_a_fault(NO, kept))
    assert not kept
    assert _require_bases(context_after_a_fault(YES, kept)) is BASES
    assert kept
