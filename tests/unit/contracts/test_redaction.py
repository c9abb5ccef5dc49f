"""What a log line may contain, value by value."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from bounded_cost import bounded_cost

from procedures.journal.errors import StepRefused
from procedures.planning.errors import PLAN_UNREADABLE, NotReachable
from procedures.workcell.errors import GUIDE_HELD_AT_ENTRY, INSTRUMENT_IN_GUIDE
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.errors import ConnectError, DataError, RonnaError
from ronna_hw.redaction import (
    ELEMENTS_LIMIT,
    REDACTED,
    TEXT_LIMIT,
    error_text,
    redact_arguments,
    redact_value,
    scrub_text,
)


class Unreadable(DataError):
    code = "XX-001"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("patient_name", "DOE^JOHN"),
        ("PatientBirthDate", "19610203"),
        ("accession", 77),
        ("institution", "St. Elsewhere"),
        ("ReferringPhysicianName", "WHO"),
        ("acknowledged_by", "Dr. Who"),
        ("control_token", "abc"),
        ("file", Path("/scans/DOE^JOHN/1.dcm")),
        ("folder", "/scans/DOE^JOHN"),
        ("file", "DOE_JOHN.dcm"),
        ("uid", "1.2.840.113619.2.55.3"),
    ],
)
def test_patient_data_credentials_and_file_paths_are_redacted(key: str, value: object) -> None:
    assert redact_value(key, value) == REDACTED


@pytest.mark.parametrize(
    "text",
    [
        "serial:///dev/serial/by-id/usb-NDI-if00",
        "udp://127.0.0.1:59152",
        "gev://169.254.1.2",
        "/dev/ttyUSB0",
        "limit 30 mm/s, 12/60 frames",
        "NDI-004: no reply within 2 s",
        "firmware 007.000.012",
    ],
)
def test_endpoints_limits_codes_and_versions_are_kept(text: str) -> None:
    assert scrub_text(text) == text


@pytest.mark.parametrize("piece", ["[", "1.", "a.", "/", "token=", ".dcm"])
def test_what_a_stranger_sends_costs_no_more_than_the_part_that_is_logged(piece: str) -> None:
    with bounded_cost(limit_s=0.1):
        logged = scrub_text(piece * (60_000 // len(piece)))
    assert len(logged) <= TEXT_LIMIT


@pytest.mark.parametrize("secret", ["DOE_JOHN.dcm", "/scans/DOE_JOHN", "1.2.840.113619.2.55", "token=6f1eaa"])
def test_a_word_that_the_limit_cuts_is_redacted_whole(secret: str) -> None:
    for kept in range(1, len(secret)):
        start = "read ".rjust(TEXT_LIMIT - kept, "-")
        assert scrub_text(start + secret) == (start + REDACTED)[:TEXT_LIMIT]


def test_the_token_in_a_control_endpoint_is_redacted() -> None:
    assert scrub_text("tcp://127.0.0.1:5000?token=6f1e&x=1") == f"tcp://127.0.0.1:5000?token={REDACTED}&x=1"


def test_values_are_redacted_at_any_depth() -> None:
    value: dict[str, Any] = {"series": [{"patient_id": "7", "slices": 12}], "wire": b"\x01\xff"}
    assert redact_value("facts", value) == {
        "series": [{"patient_id": REDACTED, "slices": 12}],
        "wire": "01 ff",
    }


def test_of_many_elements_the_first_are_kept_and_the_others_counted() -> None:
    many = range(ELEMENTS_LIMIT + 7)
    assert redact_value("numbers", many) == [*range(ELEMENTS_LIMIT), "7 more"]
    by_name = redact_value("named", {f"n{number}": number for number in many})
    assert by_name == {f"n{number}": number for number in range(ELEMENTS_LIMIT)} | {"...": "7 more"}
    assert redact_value("numbers", range(ELEMENTS_LIMIT)) == [*range(ELEMENTS_LIMIT)]


def test_a_record_is_logged_field_by_field() -> None:
    identity = Identity("NDI", "Polaris", "P9-1", "007.000")
    assert redact_value("identity", identity)["serial"] == "P9-1"


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ConnectError("tracker: no reply from /dev/ttyUSB0"), "tracker: no reply from /dev/ttyUSB0"),
        (Unreadable("DOE_JOHN is truncated"), "XX-001"),
        (RonnaError("DOE_JOHN"), "RonnaError"),
        (PLAN_UNREADABLE("line 3: expected a value, trajectory DOE_JOHN"), "PLAN-001"),
        (NotReachable("trajectory DOE_JOHN is out of reach"), "PLAN-007"),
        (StepRefused("registration:DOE_JOHN cannot start"), "PRO-001"),
        (GUIDE_HELD_AT_ENTRY("the guide is held in front of the entry of DOE_JOHN"), "PRO-014"),
        (INSTRUMENT_IN_GUIDE("an instrument is in the guide, and in DOE_JOHN"), "TOOL-001"),
        (ValueError("could not convert 'DOE'"), "ValueError"),
    ],
)
def test_an_error_message_is_logged_only_when_it_is_about_a_device(error: Exception, said: str) -> None:
    assert error_text(error) == said


def test_redacted_arguments_keep_subcommand_options_numbers_and_endpoints() -> None:
    given = ["localize", "/scans/DOE", "--expected", "5", "--pick=DOE.csv", "--x=-1.5", "tcp://127.0.0.1:1"]
    kept = ["localize", REDACTED, "--expected", "5", f"--pick={REDACTED}", "--x=-1.5", "tcp://127.0.0.1:1"]
    assert redact_arguments(given) == kept
