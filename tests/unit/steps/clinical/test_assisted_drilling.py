"""Drilling by the assistant: depths, a breakthrough against the CT, and what the operator decides."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from procedures.engine.context import StepContext
from procedures.journal.errors import GateFailed
from procedures.operator.question import NO, YES, Topic
from procedures.planning.skull_section import SkullSection
from procedures.steps.clinical.two_arms import assisted_drilling
from procedures.steps.clinical.two_arms.assisted_drilling import (
    BEHIND_SKULL_MM,
    EARLY_MM,
    LATE_MM,
    DrillDepths,
    _accept_breakthrough,
    _require_bone,
    drill_with_assistant,
)
from procedures.steps.clinical.work_progress import DepthStop
from ronna_hw.devices.contact import Inserted

INSIDE_MM = 12.5
DEPTHS = DrillDepths(SkullSection(5.7, INSIDE_MM), 100.0)
STOP = DepthStop(bore_mm=80.0, standoff_mm=10.0, depth_mm=60.0, computed_mm=150.0, read_mm=150.0)


def drilled(*, through: bool = True) -> Inserted:
    return Inserted(cast("Any", None), 10.0, 15.0, broke_through=through)


def asked_context(answer: str) -> tuple[StepContext, list[Any], list[str]]:
    asked, found = list[Any](), list[str]()

    def choose(question: Any) -> str:
        asked.append(question)
        return answer

    fields = {"trajectory": "T1", "choose": choose, "find": found.append}
    return cast("StepContext", SimpleNamespace(**fields)), asked, found


@pytest.mark.hazard(65)
@pytest.mark.parametrize("off_mm", [-EARLY_MM + 0.1, 0.0, LATE_MM - 0.1])
def test_a_breakthrough_where_the_ct_has_the_inside_is_not_asked_about(off_mm: float) -> None:
    context, asked, _ = asked_context(NO)
    assert not _accept_breakthrough(context, DEPTHS, drilled(), INSIDE_MM + off_mm)
    assert not asked


@pytest.mark.hazard(65)
@pytest.mark.parametrize(
    ("through", "depth_mm", "said"),
    [
        (True, INSIDE_MM - EARLY_MM - 0.5, r"1\.5 mm before the inside"),
        (True, INSIDE_MM + LATE_MM + 0.3, r"2\.3 mm behind the inside"),
        (False, INSIDE_MM + BEHIND_SKULL_MM, r"no breakthrough up to 15\.0 mm"),
    ],
    ids=["too early", "too late", "none"],
)
def test_a_breakthrough_elsewhere_is_for_the_operator(through: bool, depth_mm: float, said: str) -> None:
    context, asked, found = asked_context(NO)
    with pytest.raises(GateFailed, match=said):
        _accept_breakthrough(context, DEPTHS, drilled(through=through), depth_mm)
    assert [question.topic for question in asked] == [Topic.BREAKTHROUGH]
    assert len(found) == 1
    context, _, _ = asked_context(YES)
    assert _accept_breakthrough(context, DEPTHS, drilled(through=through), depth_mm) in found[0]


@pytest.mark.parametrize(
    ("drills", "senses", "skull", "error_N", "said"),
    [
        (False, True, DEPTHS.skull, 1.0, ""),
        (True, False, DEPTHS.skull, 1.0, "senses no force"),
        (True, True, None, 1.0, "no skull with an inside"),
        (True, True, DEPTHS.skull, 1.5, r"errs by 1.5 N"),
        (True, True, DEPTHS.skull, 0.0, "no error is stated"),
    ],
    ids=[
        "not asked for",
        "no force sensor",
        "no skull in the CT",
        "a force that errs by more than no bone",
        "a force of unknown error",
    ],
)
def test_a_hand_drills_where_the_assistant_cannot(
    monkeypatch: pytest.MonkeyPatch,
    drills: bool,
    senses: bool,
    skull: SkullSection | None,
    error_N: float,
    said: str,
) -> None:
    monkeypatch.setattr(assisted_drilling, "volume_of", lambda _context: None)
    monkeypatch.setattr(assisted_drilling, "measure_skull", lambda *_args: skull)
    found: list[str] = []
    planned = SimpleNamespace(trajectory=lambda _name: SimpleNamespace(trajectory=None))
    fields = {
        "trajectory": "T1",
        "find": found.append,
        "result": lambda _kind: planned,
        "setting": SimpleNamespace(settings=SimpleNamespace(assistant_drills=drills, drill_force_N=30.0)),
        "workcell": SimpleNamespace(
            assistant=SimpleNamespace(
                senses_force=senses, force_error_N=error_N, drilled_mm=lambda _trajectory: None
            )
        ),
    }
    assert drill_with_assistant(cast("StepContext", SimpleNamespace(**fields)), STOP) is None
    assert said in "".join(found)


@pytest.mark.hazard(66)
def test_a_drill_that_felt_no_bone_is_no_opening_and_nobody_is_asked() -> None:
    context, asked, _ = asked_context(YES)
    felt_none = Inserted(cast("Any", None), 4.0, 1.4, met_bone=False)
    with pytest.raises(GateFailed, match=r"felt no bone.*at most 1\.4 N up to 7\.7 mm"):
        _require_bone(context, DEPTHS, felt_none, 7.7)
    _require_bone(context, DEPTHS, drilled(), INSIDE_MM)
    assert not asked


@pytest.mark.hazard(66)
@pytest.mark.parametrize(("begun_mm", "bone_by_mm"), [(None, 7.7), (7.8, 7.7), (10.0, 12.0)])
def test_bone_is_felt_by_2_mm_behind_its_outside_or_behind_an_opening_begun_in_bone(
    begun_mm: float | None, bone_by_mm: float
) -> None:
    assert DEPTHS.bone_by_mm(begun_mm) == pytest.approx(bone_by_mm)
