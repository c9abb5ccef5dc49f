"""The tracker suite passes a good driver, and finds each kind of mistake by the case that is meant for it."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from typing import Any

import pytest

from ronna_hw.conformance.case import NEEDS, Case, NotShown, Outcome, Suite, check, refused
from ronna_hw.conformance.device_under_test import DeviceUnderTest
from ronna_hw.conformance.errors import NoSuchCase
from ronna_hw.conformance.report import run_case, run_suite
from ronna_hw.conformance.tracker import SUITE
from ronna_hw.devices.lifecycle import Identity, Lifecycle
from ronna_hw.devices.readings import StrayReading, ToolReading, TrackerFrame, Validity
from ronna_hw.errors import ConnectError, StateError

MakeDut = Callable[..., DeviceUnderTest]


def outcomes(dut: DeviceUnderTest) -> dict[str, Outcome]:
    return {case.number: run_case(case, dut).outcome for case in SUITE.cases}


def failed(dut: DeviceUnderTest) -> set[str]:
    return {number for number, outcome in outcomes(dut).items() if outcome is Outcome.FAIL}


def test_a_good_driver_passes_everything_that_applies(make_dut: MakeDut, good_tracker: Any) -> None:
    found = outcomes(make_dut(good_tracker))
    assert Outcome.FAIL not in found.values()
    assert [n for n, outcome in found.items() if outcome is Outcome.PASS] == [
        f"T{number:02d}" for number in range(1, 18)
    ]


def spoil_frame(change: Callable[[TrackerFrame], TrackerFrame]) -> Callable[[type[Any]], type[Any]]:
    def spoil(good: type[Any]) -> type[Any]:
        class Spoilt(good):  # type: ignore[misc]
            def read_frame(self, timeout_s: float = 1.0) -> TrackerFrame:
                return change(super().read_frame(timeout_s))

        return Spoilt

    return spoil


def spoil(**members: Any) -> Callable[[type[Any]], type[Any]]:
    return lambda good: type("Spoilt", (good,), members)


def with_tool(**changes: Any) -> Callable[[TrackerFrame], TrackerFrame]:
    def change(frame: TrackerFrame) -> TrackerFrame:
        tools = tuple(
            dataclasses.replace(tool, **changes) if tool.validity is Validity.OK else tool
            for tool in frame.tools
        )
        return dataclasses.replace(frame, tools=tools)

    return change


def with_stamp(**changes: Callable[[Any], Any]) -> Callable[[TrackerFrame], TrackerFrame]:
    def change(frame: TrackerFrame) -> TrackerFrame:
        values = {name: make(frame.stamp) for name, make in changes.items()}
        return dataclasses.replace(frame, stamp=dataclasses.replace(frame.stamp, **values))

    return change


def zeros_when_missing(frame: TrackerFrame) -> TrackerFrame:
    tools = tuple(
        tool if tool.validity is Validity.OK else dataclasses.replace(tool, position_mm=(0.0, 0.0, 0.0))
        for tool in frame.tools
    )
    return dataclasses.replace(frame, tools=tools)


def refuse(kind: type[Exception]) -> Callable[..., None]:
    def call(self: Any, *arguments: Any) -> None:
        raise kind("spoilt")

    return call


def allow(state: Lifecycle) -> Callable[..., None]:
    def call(self: Any, timeout_s: float = 1.0) -> None:
        if self.guard.state is not state:
            self.guard.enter(state)

    return call


MISTAKES = {
    "T02": spoil(connect=lambda self, timeout_s=1.0: connected_as(self, "")),
    "T03": spoil(configure=allow(Lifecycle.CONFIGURED), activate=lambda self, timeout_s=1.0: None),
    "T04": spoil(tools=("probe", "probe"), __init__=lambda *arguments: base_init(*arguments)),  # noqa: PLW0108 - defined below
    "T05": spoil(activate=allow(Lifecycle.ACTIVE)),
    "T06": spoil_frame(with_stamp(device_clock=lambda stamp: -stamp.device_clock)),
    "T07": spoil_frame(with_stamp(sequence=lambda stamp: 2 * stamp.sequence)),
    "T08": spoil_frame(lambda frame: dataclasses.replace(frame, tools=())),
    "T09": spoil_frame(zeros_when_missing),
    "T10": spoil_frame(with_tool(rotation=(0.9, 0.0, 0.0, 0.0))),
    "T11": spoil_frame(with_tool(fit_error_mm=-0.1)),
    "T12": spoil_frame(
        lambda frame: dataclasses.replace(frame, strays=(StrayReading((math.nan, 0.0, 0.0), Validity.OK),))
    ),
    "T13": spoil(deactivate=refuse(StateError)),
    "T14": spoil(close=lambda self: None),
    "T15": spoil(connect=lambda self, timeout_s=1.0: new_serial_each_time(self)),
    "T16": spoil(connect=lambda self, timeout_s=1.0: connected_as(self, "Good")),
    "T17": spoil(__init__=lambda self, n, c, k: base_init(self, n, c.model_copy(update={"options": {}}), k)),
}


def connected_as(tracker: Any, model: str) -> Identity:
    tracker.guard.require("connect", {Lifecycle.DISCONNECTED})
    tracker.guard.enter(Lifecycle.CONNECTED)
    return Identity("Test", model, "1", "0")


_serials = iter(range(1000))


def new_serial_each_time(tracker: Any) -> Identity:
    tracker.guard.require("connect", {Lifecycle.DISCONNECTED})
    if tracker.config.endpoint != "host:":
        raise ConnectError("nobody")
    tracker.guard.enter(Lifecycle.CONNECTED)
    return Identity("Test", "Good", f"{next(_serials)}", "0")


def base_init(tracker: Any, name: str, config: Any, clock: Any) -> None:
    base = type(tracker).__mro__[1]
    spoilt_tools = type(tracker).__dict__.get("tools")
    base.__init__(tracker, name, config, clock)
    if spoilt_tools is not None:
        tracker.tools = spoilt_tools


@pytest.mark.parametrize("number", MISTAKES)
def test_each_mistake_is_found_by_its_case(make_dut: MakeDut, good_tracker: Any, number: str) -> None:
    assert number in failed(make_dut(MISTAKES[number](good_tracker)))


def test_a_driver_without_a_call_is_no_tracker(make_dut: MakeDut, good_tracker: Any) -> None:
    class Incomplete:
        def __init__(self, name: str, config: Any, clock: Any) -> None:
            self.good = good_tracker(name, config, clock)

        def __getattr__(self, name: str) -> Any:
            if name == "recover":
                raise AttributeError(name)
            return getattr(self.good, name)

    assert failed(make_dut(Incomplete)) == {"T01"}


def test_an_error_outside_the_tree_is_a_failure(make_dut: MakeDut, good_tracker: Any) -> None:
    dut = make_dut(spoil(configure=refuse(KeyError))(good_tracker))
    result = run_case(next(case for case in SUITE.cases if case.number == "T04"), dut)
    assert result.outcome is Outcome.FAIL
    assert "no error of the tree" in result.reason


def test_a_case_is_left_out_with_the_reason(make_dut: MakeDut, good_tracker: Any) -> None:
    ran = []
    dut = make_dut(good_tracker)
    for need, reason in NEEDS.items():
        case = Case("X", "does harm", frozenset({need}), lambda dut: ran.append(1))
        result = run_case(case, dut)
        if need == "host time":
            continue
        assert (result.outcome, result.reason) == (Outcome.SKIP, reason)
    assert len(ran) == 1


def test_what_is_allowed_is_run(make_dut: MakeDut, good_tracker: Any) -> None:
    dut = make_dut(good_tracker, allowed=frozenset({"motion"}))
    assert run_case(Case("X", "moves", frozenset({"motion"}), lambda dut: None), dut).outcome is Outcome.PASS


def test_a_case_that_cannot_be_decided_says_why(make_dut: MakeDut, good_tracker: Any) -> None:
    class Blind(good_tracker):  # type: ignore[misc]
        def reading(self, tool: str) -> ToolReading:
            return ToolReading(tool, Validity.MISSING, None, None, None)

    found = outcomes(make_dut(Blind))
    assert found["T10"] is found["T11"] is Outcome.SKIP
    assert found["T09"] is Outcome.PASS


def test_the_report_counts_and_is_sealed_by_a_hash(make_dut: MakeDut, good_tracker: Any) -> None:
    shares: list[float] = []
    report = run_suite(SUITE, make_dut(good_tracker), shares.append)
    document = report.as_document()
    assert report.passed
    assert document["summary"] == {"pass": 17, "fail": 0, "skip": len(SUITE.cases) - 17}
    assert document["identity"]["model"] == "Good"
    assert len(document["sha256"]) == 64
    assert json.loads(json.dumps(document)) == document
    assert shares[-1] == 1.0


def test_a_device_that_cannot_be_connected_ends_the_run(make_dut: MakeDut, good_tracker: Any) -> None:
    with pytest.raises(ConnectError):
        run_suite(SUITE, make_dut(good_tracker, endpoint="tcp://127.0.0.1:1"))


def test_a_run_in_which_nothing_passed_has_not_passed(make_dut: MakeDut, good_tracker: Any) -> None:
    assert not run_suite(Suite("empty", "none", ()), make_dut(good_tracker)).passed


def test_case_numbers_are_unique_and_needs_known() -> None:
    suite = Suite("test", "none", ())
    suite.case("1", "one")(lambda dut: None)
    with pytest.raises(ValueError, match="two cases"):
        suite.case("1", "one again")
    with pytest.raises(ValueError, match="unknown"):
        suite.case("2", "two", needs=("magic",))
    numbers = [case.number for case in SUITE.cases]
    assert len(set(numbers)) == len(numbers) >= 40


def test_a_part_of_a_suite_is_chosen_by_the_beginning_of_its_numbers() -> None:
    assert SUITE.only([]) is SUITE
    assert [case.number for case in SUITE.only(["T01", "P0"]).cases] == [
        "T01", "P01", "P01b", "P02", "P03", "P04", "P05", "P06", "P07", "P08", "P09"
    ]  # fmt: skip
    with pytest.raises(NoSuchCase) as caught:
        SUITE.only(["Z"])
    assert caught.value.code == "CNF-003"


def test_a_check_says_what_was_expected_and_found() -> None:
    with pytest.raises(AssertionError, match="expected 1, found 2"):
        check(False, "1", 2)
    check(True, "1", 2)
    assert isinstance(refused(lambda: int("x"), ValueError, "a word"), ValueError)
    with pytest.raises(AssertionError, match="carried out"):
        refused(lambda: 1, ValueError, "a number")
    with pytest.raises(AssertionError, match="found KeyError"):
        refused(lambda: {}[1], ValueError, "a key")
    with pytest.raises(NotShown):
        raise NotShown("nothing to see")
