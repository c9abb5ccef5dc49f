"""Cases run when their needs are met, fail by Nonconformity or error, and appear in the report."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from coded_errors import raises

from conformance import case as conformance_case
from conformance.case import (
    HOST_TIME,
    MOTION,
    CaseList,
    CaseOutcome,
    Need,
    Nonconformity,
    NotShown,
    Run,
    Suite,
    SuiteCase,
    check,
    refused,
)
from conformance.device_under_test import DeviceUnderTest
from conformance.errors import NO_SUCH_CASE
from conformance.protocol import ProtocolCases, compose_suite
from conformance.report import run_case, run_suite
from ronna_hw.arguments import WrongArgument, require_numbers
from ronna_hw.errors import ConnectError, DataError

MakeDut = Callable[..., DeviceUnderTest]
NEEDS = [need for need in vars(conformance_case).values() if isinstance(need, Need)]


def does_nothing(_dut: DeviceUnderTest) -> None:
    return


def failing_with(error: Exception) -> Run:
    def run(_dut: DeviceUnderTest) -> None:
        raise error

    return run


def suite_of(**runs: Run) -> Suite:
    cases = [SuiteCase(number, f"statement of {number}", (), run) for number, run in runs.items()]
    return Suite("tracker", "none", cases=cases)


def test_a_foreign_exception_is_a_failure(make_dut: MakeDut, good_tracker: Any) -> None:
    result = run_case(SuiteCase("X", "breaks", (), failing_with(KeyError("x"))), make_dut(good_tracker))
    assert result.outcome is CaseOutcome.FAIL
    assert "KeyError" in result.reason


def test_a_reason_is_one_line_that_steers_no_terminal(make_dut: MakeDut, good_tracker: Any) -> None:
    failing = failing_with(Nonconformity("got \x1b[2J" + "x" * 70_000))
    reason = run_case(SuiteCase("X", "breaks", (), failing), make_dut(good_tracker)).reason
    assert reason.isprintable()
    assert len(reason) < 400


@pytest.mark.parametrize(
    "need", [need for need in NEEDS if need is not HOST_TIME], ids=lambda need: need.name
)
def test_a_case_with_an_unmet_need_is_skipped_with_the_reason(
    make_dut: MakeDut, good_tracker: Any, need: Need
) -> None:
    result = run_case(
        SuiteCase("X", "does harm", (need,), failing_with(AssertionError())), make_dut(good_tracker)
    )
    assert (result.outcome, result.reason) == (CaseOutcome.SKIP, need.reason)


def test_a_case_whose_need_is_allowed_runs(make_dut: MakeDut, good_tracker: Any) -> None:
    dut = make_dut(good_tracker, allowed=frozenset({"motion"}))
    assert run_case(SuiteCase("X", "moves", (MOTION,), does_nothing), dut).outcome is CaseOutcome.PASS


def test_a_protocol_can_define_and_offer_its_own_needs(make_dut: MakeDut, good_tracker: Any) -> None:
    frobnication = Need("frobnication", "the device does not frobnicate")
    case = SuiteCase("F01", "frobnicates", (frobnication,), does_nothing)
    protocol = ProtocolCases((case,), offers=lambda dut: frozenset({frobnication.name}))
    assert run_case(case, make_dut(good_tracker)).reason == frobnication.reason
    assert run_case(case, make_dut(good_tracker, protocol=protocol)).outcome is CaseOutcome.PASS


def test_the_report_counts_outcomes_and_carries_a_hash(make_dut: MakeDut, good_tracker: Any) -> None:
    shares: list[float] = []
    suite = suite_of(A1=does_nothing, A2=failing_with(NotShown("too dark")), A3=does_nothing)
    report = run_suite(suite, make_dut(good_tracker), shares.append)
    document = report.as_document()
    assert report.passed
    assert document["summary"] == {"pass": 2, "fail": 0, "skip": 1}
    assert document["identity"]["model"] == "Good"
    assert len(document["sha256"]) == 64
    assert json.loads(json.dumps(document)) == document
    assert shares[-1] == 1.0


def test_a_device_that_cannot_be_connected_aborts_the_suite(make_dut: MakeDut, good_tracker: Any) -> None:
    with pytest.raises(ConnectError):
        run_suite(suite_of(A1=does_nothing), make_dut(good_tracker, endpoint="tcp://127.0.0.1:1"))


def test_a_run_without_a_passed_case_has_not_passed(make_dut: MakeDut, good_tracker: Any) -> None:
    assert not run_suite(suite_of(), make_dut(good_tracker)).passed


def test_case_numbers_are_unique_in_a_list_and_in_a_composed_suite() -> None:
    cases = CaseList()
    cases.case("A1", "one")(does_nothing)
    with pytest.raises(ValueError, match="two cases"):
        cases.case("A1", "one again")
    with pytest.raises(ValueError, match="A1"):
        compose_suite(suite_of(A1=does_nothing), ProtocolCases(tuple(cases.cases)))


def test_part_of_a_suite_is_selected_by_case_number_prefix() -> None:
    suite = suite_of(
        T01=does_nothing, T10=does_nothing, P01=does_nothing, P01b=does_nothing, P10=does_nothing
    )
    assert suite.only([]) is suite
    assert [case.number for case in suite.only(["T01", "P0"]).cases] == ["T01", "P01", "P01b"]
    with raises(NO_SUCH_CASE) as caught:
        suite.only(["Z"])
    assert caught.value.code == "CNF-003"


def test_a_failed_check_reports_what_was_expected_and_found() -> None:
    with pytest.raises(AssertionError, match="expected 1, got 2"):
        check(False, "1", 2)
    check(True, "1", 2)
    assert refused(lambda: require_numbers("x", "a word"), DataError, "a word").code == WrongArgument.code
    with pytest.raises(AssertionError, match="carried out"):
        refused(lambda: 1, DataError, "a number")
    with pytest.raises(AssertionError, match="got KeyError"):
        refused(lambda: {}[1], DataError, "a key")
