"""Advice about expired records: a command for each that a command makes, words for the others."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from typing import cast

import pytest

from procedures.calibration.validity import MADE_BY_COMMAND, MADE_BY_HAND, require_valid
from ronna_hw.calibration import CalibrationExpired, DatedRecord
from ronna_hw.config import Calibrations
from ronna_hw.roles import ONE_ARM

NOW = datetime(2026, 11, 27, tzinfo=UTC)
EXPIRED = DatedRecord(
    identifier="one",
    created=NOW - timedelta(days=9),
    expires=NOW - timedelta(days=1),
    made_by="bench",
    stated_error_mm=0.1,
)


@pytest.mark.parametrize(
    ("expired", "advice"),
    [
        (("arm", "tool_tip"), "Run ronna-arm calibrate, then ronna-procedure calibrate tool-tip"),
        (("assistant_holder",), "Measure the assistant's holder again"),
        (("assistant_arm", "arm"), "Run ronna-arm calibrate; calibrate the assistant as [robot.master]"),
    ],
)
def test_an_expired_record_is_renewed_by_its_command_or_by_hand(
    expired: tuple[str, ...], advice: str
) -> None:
    records = SimpleNamespace(records=dict.fromkeys(expired, EXPIRED), arm=None, stereo_head=None)
    with pytest.raises(CalibrationExpired) as refused:
        require_valid(cast("Calibrations", records), NOW)
    assert refused.value.advice.startswith(advice)
    assert refused.value.advice.endswith("; no motion until then.")


def test_a_case_of_the_master_alone_needs_no_record_of_the_assistant() -> None:
    fields = dict.fromkeys(Calibrations.model_fields, EXPIRED)
    assert {*Calibrations.model_construct(**fields).of_arms(ONE_ARM).records} == {
        name for name in fields if "assistant" not in name
    }


def test_there_is_a_way_to_renew_each_record() -> None:
    assert {*MADE_BY_COMMAND, *MADE_BY_HAND} == set(Calibrations.model_fields)
