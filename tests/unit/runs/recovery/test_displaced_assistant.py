"""An assistant in the guide is compared with its frame before a resumed case moves anything."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from two_arm_room import OVER_GUIDE_RAD, TwoArmRoom, shifted

from procedures.guards.errors import InsertionDisturbed
from procedures.journal.journal import Line
from procedures.runs import arm_comparison
from procedures.runs.arm_comparison import compare_arms
from procedures.runs.comparison import Comparison
from procedures.steps.clinical.two_arms import seen_on_axis
from procedures.steps.clinical.two_arms.seen_on_axis import LOOK_AT_CART, look_before_retreat
from ronna_hw.errors import LinkTimeout

LINES: tuple[Line, ...] = ()


def watched(monkeypatch: pytest.MonkeyPatch, **seen: Any) -> tuple[Any, Any]:
    """A workcell with an instrument in the guide, and a watch whose next look shows this."""
    room = TwoArmRoom()
    room.look(OVER_GUIDE_RAD, led=True)
    monkeypatch.setattr(seen_on_axis, "read_frames_at_rest", lambda *_args, **_named: ([], 0))
    monkeypatch.setattr(room.watch, "read", lambda *_args: room.reading(led=True, **seen))
    return room.workcell(), room.watch


def compare_seen(monkeypatch: pytest.MonkeyPatch, watch: object = None, **seen: Any) -> Comparison:
    workcell, known = watched(monkeypatch, **seen)
    workcell.assistant.require_on_axis = lambda: 120.0
    workcell.assistant.history = SimpleNamespace(base=object(), held=None)
    monkeypatch.setattr(arm_comparison, "_watch_with_bases", lambda _engine: watch or known)
    monkeypatch.setattr(arm_comparison, "_compare_guide", lambda *_known: None)
    engine = SimpleNamespace(setting=SimpleNamespace(workcell=workcell, clock=None))
    left = SimpleNamespace(run=SimpleNamespace(chain=SimpleNamespace(lines=LINES, torn=b""), lost=()))
    comparison = Comparison()
    compare_arms(cast("Any", engine), cast("Any", left), comparison)
    return comparison


@pytest.mark.hazard(64)
def test_a_displaced_assistant_leads_no_instrument_out_of_the_guide(monkeypatch: pytest.MonkeyPatch) -> None:
    (refused,) = compare_seen(monkeypatch, assistant=shifted(0.0, 0.6, 0.0)).differences
    assert refused.startswith("PRO-054")
    assert "open the clamp of the assistant's holder" in refused


@pytest.mark.hazard(64)
def test_a_displaced_assistant_is_refused_also_while_the_guides_arm_is_hidden(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (refused,) = compare_seen(monkeypatch, guide_hidden=True, assistant=shifted(0.0, 1.2, 0.0)).differences
    assert refused.startswith("PRO-054")
    in_place = compare_seen(monkeypatch, guide_hidden=True)
    assert in_place.differences == []
    assert "the frame on the arm with the guide" in in_place.warnings[0]


@pytest.mark.hazard(64)
def test_a_guide_whose_cart_was_displaced_keeps_its_instrument(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InsertionDisturbed, match="PRO-054"):
        look_before_retreat(*watched(monkeypatch, master=shifted(0.0, 0.6, 0.0)))


def test_a_head_that_has_moved_does_not_hold_up_the_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    assert look_before_retreat(*watched(monkeypatch, head=shifted(0.0, 2.0, 0.0))) == ""


def test_an_assistant_on_its_axis_may_lead_the_instrument_out(monkeypatch: pytest.MonkeyPatch) -> None:
    comparison = compare_seen(monkeypatch)
    assert comparison.differences == comparison.warnings == []
    assert "120 of the" in comparison.notes[0]
    assert "on the axis of T1" in comparison.notes[1]


@pytest.mark.hazard(64)
def test_staff_look_at_an_assistant_that_the_tracker_cannot_compare(monkeypatch: pytest.MonkeyPatch) -> None:
    hidden = compare_seen(monkeypatch, hidden=True)
    without_bases = compare_seen(monkeypatch, watch=TwoArmRoom(known=False).watch)
    workcell, watch = watched(monkeypatch)

    def unreadable(*_args: object, **_named: object) -> None:
        raise LinkTimeout("no reply")

    monkeypatch.setattr(seen_on_axis, "read_frames_at_rest", unreadable)
    silent = look_before_retreat(workcell, watch)
    assert hidden.differences == without_bases.differences == []
    assert LOOK_AT_CART in hidden.warnings[0]
    assert LOOK_AT_CART in without_bases.warnings[0]
    assert "no reply" in silent
    assert LOOK_AT_CART in silent
