"""Insertion by the assistant: what it relies on."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest
from two_arm_room import OVER_GUIDE_RAD, TwoArmRoom, shifted

from procedures.engine.context import StepContext
from procedures.guards.assistant_on_axis import LARGEST_OFF_MM
from procedures.guards.errors import InsertionDisturbed
from procedures.guards.guide_displacement import PUSHED_MM
from procedures.journal.errors import GateFailed
from procedures.operator.question import NO, YES
from procedures.steps.clinical.two_arms import over_guide
from procedures.steps.clinical.two_arms.over_guide import (
    _require_bases,
    _require_seen_coaxial,
    bring_over_guide,
)

BASES = object()
AXIS = cast("Any", SimpleNamespace(arriving=None))


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


def over_the_guide(monkeypatch: pytest.MonkeyPatch, **seen: Any) -> tuple[StepContext, list[str]]:
    """A context whose next look at the room is over the guide, with both arms known."""
    room, found = TwoArmRoom(), list[str]()
    monkeypatch.setattr(over_guide, "room_watch", lambda _context: room.watch)
    room.joints_rad = OVER_GUIDE_RAD
    look = partial(room.look, **seen)
    monkeypatch.setattr(over_guide, "check_room", lambda *_args: look())
    kept: list[Any] = []
    memory = SimpleNamespace(keep=kept.append, find=lambda _kind: kept[-1] if kept else None)
    fields = {
        "trajectory": "T1",
        "workcell": room.workcell(),
        "setting": SimpleNamespace(memory=memory, clock=None),
        "find": found.append,
        "progress": lambda *_args: None,
    }
    return cast("StepContext", SimpleNamespace(**fields)), found


@pytest.mark.hazard(61)
def test_joints_alone_do_not_lead_an_instrument_into_the_guide(monkeypatch: pytest.MonkeyPatch) -> None:
    context, found = over_the_guide(monkeypatch, hidden=True)
    with pytest.raises(GateFailed, match=r"at this target with the holder empty.*has stood still"):
        _require_seen_coaxial(context, AXIS, ["with the holder empty"])
    assert _require_seen_coaxial(context, AXIS, []) is None
    assert "where it stood" in found[0]


@pytest.mark.hazard(61)
def test_a_bore_that_no_frame_shows_takes_no_instrument(monkeypatch: pytest.MonkeyPatch) -> None:
    context, found = over_the_guide(monkeypatch, guide_hidden=True)
    rest = SimpleNamespace(look=lambda *_args: None, is_unseen=True, now_mm=0.0)
    context.setting.memory.keep(rest)
    with pytest.raises(GateFailed, match="nothing shows that the bore is where it was"):
        _require_seen_coaxial(context, AXIS, [])
    rest.is_unseen = False
    assert _require_seen_coaxial(context, AXIS, []) is not None
    assert "the guide's arm is hidden" in found[-1]
    rest.now_mm = 2.0 * PUSHED_MM
    with pytest.raises(GateFailed, match=r"not where it was held.*limit 0\.2 mm, got 0\.40 mm"):
        _require_seen_coaxial(context, AXIS, [])


@pytest.mark.hazard(61)
def test_nothing_is_led_into_a_bore_that_may_be_further_off_than_the_instrument_gives_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    context, found = over_the_guide(monkeypatch)
    seen = _require_seen_coaxial(context, AXIS, [])
    assert seen is not None
    assert f"known to {seen.uncertain_mm:.2f} mm" in found[0]
    context, _ = over_the_guide(monkeypatch, assistant=shifted(0.0, LARGEST_OFF_MM - 0.15, 0.0))
    with pytest.raises(GateFailed, match=r"may be further beside the bore.*limit 0\.8 mm"):
        _require_seen_coaxial(context, AXIS, [])


@pytest.mark.hazard(64)
def test_a_repeated_step_leads_no_instrument_out_beside_the_bore(monkeypatch: pytest.MonkeyPatch) -> None:
    def seen_beside(*_args: object) -> str:
        raise InsertionDisturbed("a cart was displaced")

    led_out: list[str] = []

    def lead_out(doubt: str) -> None:
        led_out.append(doubt)

    assistant = SimpleNamespace(place=SimpleNamespace(is_on_axis=True), lead_out=lead_out)
    workcell = SimpleNamespace(assistant=assistant, assistants=(assistant,), start=lambda: None)
    fields = {"workcell": workcell, "trajectory": "T1", "setting": SimpleNamespace(clock=None)}
    context = cast("StepContext", SimpleNamespace(**fields, rest_drill=lambda: None))
    monkeypatch.setattr(over_guide, "room_watch", lambda _context: None)
    monkeypatch.setattr(over_guide, "look_before_retreat", seen_beside)
    with pytest.raises(InsertionDisturbed):
        bring_over_guide(context, cast("Any", None))
    assert not led_out
