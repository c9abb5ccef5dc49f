"""The tracker suite passes a good driver and finds each kind of mistake by its own case."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest

from conformance.case import CaseOutcome
from conformance.device_under_test import DeviceUnderTest
from conformance.report import run_case
from conformance.tracker import SUITE
from ronna_hw.devices.lifecycle import Identity, LastKnown, Lifecycle, hold_active
from ronna_hw.devices.readings import StrayReading, ToolReading, TrackerFrame, Validity
from ronna_hw.errors import ConnectError, StateError

MakeDut = Callable[..., DeviceUnderTest]


def outcomes(dut: DeviceUnderTest) -> dict[str, CaseOutcome]:
    return {case.number: run_case(case, dut).outcome for case in SUITE.cases}


def failed(dut: DeviceUnderTest) -> set[str]:
    return {number for number, outcome in outcomes(dut).items() if outcome is CaseOutcome.FAIL}


def test_a_good_driver_passes_all_applicable_cases(make_dut: MakeDut, good_tracker: Any) -> None:
    found = outcomes(make_dut(good_tracker))
    assert CaseOutcome.FAIL not in found.values()
    assert [n for n, outcome in found.items() if outcome is CaseOutcome.PASS] == [
        f"T{number:02d}" for number in (*range(1, 18), *range(23, 27))
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


@contextmanager
def stays_active(tracker: Any, timeout_s: float = 1.0) -> Iterator[Any]:
    tracker.connect()
    tracker.configure()
    tracker.activate()
    yield tracker


@contextmanager
def swallows_exceptions(tracker: Any, timeout_s: float = 1.0) -> Iterator[Any]:
    with suppress(Exception), hold_active(tracker) as active:
        yield active


def latches_when_looked_at(tracker: Any) -> LastKnown[Any]:
    tracker.guard.latch(StateError("looked at"))
    known: LastKnown[Any] = tracker.guard.last_known(None)
    return known


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
    "T23": spoil(active=stays_active),
    "T24": spoil(active=swallows_exceptions),
    "T25": spoil(observe=latches_when_looked_at),
    "T26": spoil(connect=lambda self, timeout_s=1.0: new_serial_each_time(self)),
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


def test_a_driver_with_a_missing_method_fails(make_dut: MakeDut, good_tracker: Any) -> None:
    class Incomplete:
        def __init__(self, name: str, config: Any, clock: Any) -> None:
            self.good = good_tracker(name, config, clock)

        def __getattr__(self, name: str) -> Any:
            if name == "recover":
                raise AttributeError(name)
            return getattr(self.good, name)

    assert "T01" in failed(make_dut(Incomplete))


def test_undecidable_cases_are_skipped(make_dut: MakeDut, good_tracker: Any) -> None:
    class Blind(good_tracker):  # type: ignore[misc]
        def reading(self, tool: str) -> ToolReading:
            return ToolReading(tool, Validity.MISSING, None, None, None)

    found = outcomes(make_dut(Blind))
    assert found["T10"] is found["T11"] is CaseOutcome.SKIP
    assert found["T09"] is CaseOutcome.PASS
