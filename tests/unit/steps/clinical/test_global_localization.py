"""The coarse localization reports the cause of a failure, not its consequences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType, SimpleNamespace
from typing import Any, cast

import pytest
from clinical_case import SPHERES_MM, ClinicalCell
from prepared_results import checked_set_up, clamped_head, locked_cart
from pushed_tracker import with_patient_frame

from procedures.journal.errors import GateFailed
from procedures.steps.clinical.global_localization import IN_CASE, MOST_READINGS, STEP, GlobalLocalization
from procedures.workcell import MountedTool
from procedures.workcell.tracker_look import FRAMES, MOST_LOST_READINGS, average_pose, read_fresh_frames
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.lifecycle import LastKnown, Lifecycle
from ronna_hw.devices.readings import Stamp, ToolReading, TrackerFrame, Validity
from ronna_hw.errors import DeviceError, LinkTimeout


class Bumped(DeviceError):
    """The tracker was knocked."""

    code = "TST-001"


@dataclass
class TrackerThatFails:
    """A tracker whose first reading fails; `latched` says whether that is a fault of the device."""

    latched: bool
    state: Lifecycle = Lifecycle.CONFIGURED
    calls: list[str] = field(default_factory=list)

    def observe(self) -> LastKnown[object]:
        return LastKnown(self.state, None, None)

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
def test_the_step_fails_with_the_trackers_own_fault(latched: bool, cell: ClinicalCell) -> None:
    tracker = TrackerThatFails(latched)
    cell.opened.replace_device("tracker", tracker)
    cell.workcell.master.mount.check(MountedTool.STEREO_HEAD)
    with pytest.raises(Bumped):
        cell.begin(checked_set_up(cell), STEP).run_to()
    assert tracker.calls == ([] if latched else ["deactivate"])


def test_too_few_spheres_are_no_localization(cell: ClinicalCell) -> None:
    cell.tracker.spheres_mm = SPHERES_MM[:2]  # the arm hides the others
    with pytest.raises(GateFailed, match=r"too few spheres; limit at least 3 spheres, got 2.*arm home"):
        cell.begin(checked_set_up(cell), clamped_head(), locked_cart(), IN_CASE).run_to()


def frame(validity: Validity = Validity.OK, tool: Validity = Validity.MISSING) -> TrackerFrame:
    return TrackerFrame(Stamp(0, 0, 0.0), validity, (ToolReading("M", tool, None, None, None),), ())


class LineThatLoses:
    """A tracker of which every third reading is lost."""

    state = Lifecycle.ACTIVE
    markers_mm: Mapping[str, Any] = MappingProxyType({})

    def __init__(self, lost_of_three: int) -> None:
        self._lost_of_three = lost_of_three
        self._calls = 0

    def read_frame(self) -> TrackerFrame:
        self._calls += 1
        if self._calls % 3 < self._lost_of_three:
            raise LinkTimeout("no reply")
        return frame()


def read_from(tracker: object) -> tuple[list[TrackerFrame], int]:
    clock: Any = SimpleNamespace(now_s=lambda: 0.0)
    return read_fresh_frames(cast("Any", tracker), clock, lambda _share: None)


def test_a_lost_reply_costs_a_reading_but_does_not_end_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("procedures.workcell.tracker_look.MOST_LOST_READINGS", FRAMES)
    frames, lost = read_from(LineThatLoses(1))
    assert (len(frames), lost) == (FRAMES, FRAMES // 2 - 1)


def test_too_many_lost_replies_end_the_step() -> None:
    assert MOST_LOST_READINGS < FRAMES // 2
    with pytest.raises(LinkTimeout):
        read_from(LineThatLoses(2))


@pytest.mark.parametrize(
    ("seen", "action"),
    [
        (frame(tool=Validity.MISSING), "Clear the line of sight"),
        (frame(tool=Validity.OUT_OF_VOLUME), "Move the tracker"),
        (frame(Validity.PARTIAL, Validity.PARTIAL), "Shade the tracker"),
    ],
)
@pytest.mark.branch("SIGHT_LOST")
def test_the_advice_depends_on_why_the_tool_was_not_seen(seen: TrackerFrame, action: str) -> None:
    with pytest.raises(GateFailed, match=f"in 0 of 3 frames.*{action}"):
        average_pose([seen] * 3, "M")


@pytest.mark.hazard(13)
@pytest.mark.parametrize("at", [FRAMES // 2, FRAMES - 10], ids=["amid it", "at its end"])
@pytest.mark.parametrize("pushes", [1, MOST_READINGS])
def test_a_reading_in_which_the_tracker_was_pushed_is_repeated_and_not_without_end(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch, pushes: int, at: int
) -> None:
    tracker = with_patient_frame(cell, MountedTool.STEREO_HEAD)
    read, taken = tracker.read_frame, []

    def read_frame(timeout_s: float = 1.0) -> TrackerFrame:
        taken.append(timeout_s)
        if len(taken) % FRAMES == at and len(taken) < pushes * FRAMES:
            tracker.push((9.0, -4.0, 6.0))
        return read(timeout_s)

    monkeypatch.setattr(tracker, "read_frame", read_frame)
    before = (checked_set_up(cell), clamped_head(), locked_cart())
    if pushes == MOST_READINGS:
        with pytest.raises(GateFailed, match=r"PRO-007: the tracker.*moved in each reading.*moved in all 3"):
            cell.run(*before, STEP)
    else:
        localized = cell.run(*before, STEP).result
        assert isinstance(localized, GlobalLocalization)
        assert localized.frames == FRAMES
    assert len(taken) == min(pushes + 1, MOST_READINGS) * FRAMES
