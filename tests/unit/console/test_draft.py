"""A plan while it is drawn: changes, undo and redo."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from console.planning.draft import Axis, Draft, DraftHistory
from procedures.planning.errors import AcPcUnfit
from procedures.planning.plan_file import parse_plan
from procedures.planning.plan_model import PlanFusion

ENTRY, TARGET = (10.0, -50.0, 60.0), (5.0, -20.0, 20.0)
AC, PC, FALX = (2.0, -5.0, 37.5), (2.0, 15.0, 22.5), (2.0, 23.4, 66.2)


def drawn() -> Draft:
    draft = Draft("HFS", 4, instrument_length_mm=250.0)
    return draft.with_way("T1", replace(draft.way("T1"), entry_mm=ENTRY, target_mm=TARGET))


def test_a_draft_becomes_a_plan_of_its_complete_trajectories() -> None:
    draft, name = drawn().with_new_way()
    assert name == "T2"
    plan = parse_plan(draft.content("1.2.3"))
    assert [one.id for one in plan.trajectories] == ["T1"]
    assert Draft.of(plan).ways == drawn().ways


def test_ac_pc_points_are_clicked_in_turn_kept_in_the_plan_and_refused_if_they_give_no_frame() -> None:
    draft = drawn().with_landmark(AC).with_landmark(PC)
    assert draft.ac_pc is None
    assert "ac_pc" not in draft.content("1.2.3"), "as long as there are two"
    with pytest.raises(AcPcUnfit):
        draft.with_landmark(AC)
    with pytest.raises(AcPcUnfit):
        drawn().with_landmark(AC).with_landmark(AC)
    whole = draft.with_landmark(FALX)
    assert whole.ac_pc is not None
    assert Draft.of(parse_plan(whole.content("1.2.3"))).landmarks == (AC, PC, FALX)
    assert whole.with_landmark(PC).landmarks == (PC,), "a fourth click begins anew"


def test_the_fusion_by_which_a_target_was_chosen_survives_the_planner() -> None:
    fusion = PlanFusion(series_instance_uid="1.2.840.5", modality="MR", record_sha256="a" * 64)
    draft = replace(drawn(), fusion=fusion)
    draft = draft.with_way("T1", replace(draft.way("T1"), fusion_error_mm=0.4))
    again = Draft.of(parse_plan(draft.content("1.2.3")))
    assert (again.fusion, again.way("T1").fusion_error_mm) == (fusion, 0.4)
    assert "fusion" not in replace(draft, ways=drawn().ways).content("1.2.3"), "no target is left of it"


def test_undo_and_redo_go_step_by_step() -> None:
    history = DraftHistory(drawn())
    first, second = replace(drawn(), standoff_mm=31.0), replace(drawn(), standoff_mm=32.0)
    history.change(first)
    history.change(second)
    history.undo()
    assert history.now == first
    history.redo()
    assert history.now == second
    history.undo()
    history.undo()
    history.undo()
    assert history.now == drawn()
    assert not history.can_undo
    history.change(second)
    assert not history.can_redo


def test_a_drag_is_undone_as_one_step() -> None:
    history = DraftHistory(drawn())
    for step, standoff_mm in enumerate((31.0, 32.0, 33.0)):
        history.change(replace(drawn(), standoff_mm=standoff_mm), continues=step > 0)
    history.undo()
    assert history.now == drawn()


def test_axis_and_depth_reproduce_the_entry() -> None:
    axis = Axis.of(ENTRY, TARGET)
    assert axis.entry_mm(TARGET, math.dist(ENTRY, TARGET)) == pytest.approx(ENTRY)
    assert Axis.of((9.0, 0.0, 0.0), (0.0, 0.0, 0.0)) == Axis(0.0, 0.0)
    assert Axis.of((0.0, 9.0, 9.0), (0.0, 0.0, 0.0)) == Axis(pytest.approx(90.0), pytest.approx(45.0))


def test_trajectory_names_are_not_duplicated_and_one_trajectory_always_remains() -> None:
    draft, _ = drawn().with_new_way()
    draft = draft.without_way("T1")
    assert [one.identifier for one in draft.ways] == ["T2"]
    draft, name = draft.with_new_way()
    assert name == "T1"
    assert [one.ends for one in draft.without_way("T1").without_way("T2").ways] == [None]
