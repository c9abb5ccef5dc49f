"""The coarse localization tells what went wrong, not what followed from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from procedures.steps.global_localization import run
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import DeviceError


class Bumped(DeviceError):
    """The tracker was knocked."""

    code = "TST-001"


@dataclass
class TrackerThatFails:
    """A tracker whose first reading fails; `latched` says whether that is a fault of the device."""

    latched: bool
    state: Lifecycle = Lifecycle.CONFIGURED
    calls: list[str] = field(default_factory=list)

    def activate(self) -> None:
        self.state = Lifecycle.ACTIVE

    def read_frame(self) -> None:
        self.state = Lifecycle.FAULT if self.latched else Lifecycle.ACTIVE
        raise Bumped("somebody knocked against the unit")

    def deactivate(self) -> None:
        if self.state is Lifecycle.FAULT:
            raise WrongState("deactivate is not allowed while fault")
        self.calls.append("deactivate")


@pytest.mark.parametrize("latched", [True, False])
def test_the_fault_of_the_tracker_is_what_the_step_fails_with(latched: bool) -> None:
    tracker = TrackerThatFails(latched)
    context: Any = SimpleNamespace(
        devices=SimpleNamespace(tracker=tracker),
        clock=SimpleNamespace(now_s=lambda: 0.0),
        progress=lambda *_: None,
    )
    with pytest.raises(Bumped):
        run(context)
    assert tracker.calls == ([] if latched else ["deactivate"])
