"""Hazard 50: after a cart move nothing that depended on its place is used, and nothing is done twice."""

from __future__ import annotations

from pathlib import Path

import pytest
from clinical_case import FIRST, LAST, ClinicalCell, done_later
from prepared_results import (
    checked_paths,
    checked_plan,
    checked_set_up,
    clamped_head,
    imported_ct,
    localized_fiducials,
)

from procedures.engine.case import StepKey
from procedures.engine.engine import Engine
from procedures.engine.order import Scope
from procedures.guards.errors import INPUT_CHANGED, BaseShifted, PatientMoved
from procedures.journal.errors import StepRefused
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from procedures.runs.engine_setup import MOST_MOVES, MovedCart
from procedures.runs.interrupted_run import read_interrupted_run
from procedures.runs.way_out import has_head_moved, surround_arms
from procedures.steps.branches import HOLD
from procedures.steps.clinical import cart_lock, correspondence, global_localization, relocalization
from procedures.steps.clinical.correspondence import Correspondence
from procedures.workcell import MountedTool
from ronna_hw.errors import LinkTimeout, RonnaError

pytestmark = [pytest.mark.hazard(50), pytest.mark.branch("CART_MOVED")]
KEPT = ["ct_import", "fiducial_localization", "plan_check", "set_up", "head_clamp"]


def localizing(cell: ClinicalCell) -> Engine:
    """A case in which the cart can move before or while the spheres are localized."""
    cell.carrying(MountedTool.STEREO_HEAD)
    before = (imported_ct(), localized_fiducials(), checked_plan(), checked_set_up(cell), clamped_head())
    steps = (cart_lock.STEP, global_localization.IN_CASE, correspondence.STEP, checked_paths(cell))
    engine = cell.begin(*before, *steps, relocalization.STEP)
    engine.goes_on = MovedCart(engine).continues_by_consent
    return engine


def move_at(cell: ClinicalCell, step: str) -> None:
    """The cart is pushed when that step begins, for the first time."""
    announce = cell.room.announce

    def announced(name: str) -> None:
        announce(name)
        if cell.room.announced.count(name) == 1 and name == step:
            cell.tracker.frame_shift_mm = (0.0, 2.0, 0.0)

    cell.room.announce = announced  # type: ignore[method-assign]


def moves_asked(cell: ClinicalCell) -> int:
    return [question.topic for question in cell.operator.asked].count(Topic.CART_MOVED)


@pytest.mark.parametrize(
    ("step", "moves"),
    [
        ("cart_lock", 0),
        ("global_localization", 0),
        (f"relocalization:{FIRST}", 1),
        (f"relocalization:{LAST}", 1),
    ],
)
def test_a_move_voids_results_that_depend_on_the_place_and_the_case_continues_from_the_lock(
    tmp_path: Path, step: str, moves: int
) -> None:
    cell = ClinicalCell(tmp_path)
    engine = localizing(cell)
    move_at(cell, step)
    engine.run_to()

    questions = [one for one in cell.operator.asked if one.topic is Topic.CART_MOVED]
    assert len(questions) == moves
    for question in questions:
        assert "the cart of the robot was moved, or somebody leans on arm or guide: " in question.subject
        assert "the frame on the arm by 2.00 mm" in question.subject
        assert "cart_lock is next" in question.subject
        assert ", ".join(KEPT) in question.value
        assert question.deliberate
    assert cell.entries("voided") == [("voided", "cart_lock")] * moves
    done = [name for _, name in cell.entries("result")]
    assert all(done.count(name) == 1 for name in KEPT)
    assert done.count("cart_lock") == done.count("global_localization") == 1 + moves
    assert engine.upcoming is None


def test_the_case_is_held_before_the_cart_lock_without_consent(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    engine = localizing(cell)
    cell.operator.answers = {Topic.CART_MOVED: HOLD}
    move_at(cell, f"relocalization:{FIRST}")
    with pytest.raises(BaseShifted):
        engine.run_to()
    assert str(engine.upcoming) == "cart_lock"
    assert cell.arm.motions == []


def test_a_cart_that_keeps_moving_stops_the_case_after_the_maximum_number_of_moves(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    engine = localizing(cell)
    announce = cell.room.announce

    def announced(name: str) -> None:
        announce(name)
        if name == f"relocalization:{FIRST}":
            x, y, z = cell.tracker.frame_shift_mm
            cell.tracker.frame_shift_mm = (x, y + 2.0, z)

    cell.room.announce = announced  # type: ignore[method-assign]
    with pytest.raises(BaseShifted):
        engine.run_to()
    assert moves_asked(cell) == MOST_MOVES


@pytest.mark.parametrize(
    "problem",
    [PatientMoved("the head has moved"), INPUT_CHANGED("the plan has changed"), LinkTimeout("silent")],
    ids=lambda problem: type(problem).__name__,
)
def test_the_case_continues_on_its_own_after_a_cart_move_only(tmp_path: Path, problem: RonnaError) -> None:
    cell = ClinicalCell(tmp_path)
    assert not MovedCart(localizing(cell)).continues_by_consent(problem)
    assert moves_asked(cell) == 0


class Plan(StepResult, kind="plan"):
    """What everything depends on."""


class Place(StepResult, kind="place"):
    """What depends on where the cart stands."""


class Target(StepResult, kind="target"):
    """What is done at a target."""


class Out(StepResult, kind="out"):
    """The end of a trajectory."""


def steps_of(cell: ClinicalCell) -> Engine:
    return cell.begin(
        Plan(),
        done_later(Place(), Plan),
        done_later(Target(), Place, scope=Scope.TRAJECTORY, finishes=True),
        done_later(Out(), Target, scope=Scope.TRAJECTORY),
    )


def half_done(cell: ClinicalCell, last: str) -> Engine:
    """The work at the first target is done, and then the cart moves."""
    engine = steps_of(cell)
    engine.run_to(engine.order.find(last))
    engine.void(StepKey("place"), BaseShifted("the cart has moved"))
    return engine


@pytest.mark.parametrize("last", [f"target:{FIRST}", f"out:{FIRST}"])
def test_work_at_a_finished_target_remains_valid_and_is_not_repeated(tmp_path: Path, last: str) -> None:
    cell = ClinicalCell(tmp_path)
    engine = half_done(cell, last)
    stands = [str(key) for key in engine.order.sequence if engine.case.stands(key)]
    assert stands == ["plan", f"target:{FIRST}", f"out:{FIRST}"][: 2 + last.startswith("out")]
    engine.run_to()
    assert [name for _, name in cell.entries("result")][-3:] == ["place", f"target:{LAST}", f"out:{LAST}"]


def test_a_step_refuses_results_from_before_the_move(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    engine = half_done(cell, f"target:{FIRST}")
    engine.run_step(engine.order.find("place"))
    with pytest.raises(StepRefused, match="made before something moved: 03-target"):
        engine.run_step(engine.order.find(f"out:{FIRST}"))
    assert not engine.context(engine.order.find("place")).stands(Target)


def test_a_resumed_run_knows_its_finished_targets(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    engine = half_done(cell, f"out:{FIRST}")
    engine.close("left")
    case = read_interrupted_run(tmp_path).restore_case(engine.order)
    assert [stored.record.identifier for stored in case.valid_results] == [
        "01-plan",
        f"03-target-{FIRST}",
        f"04-out-{FIRST}",
    ]


def test_a_repeated_step_leaves_a_finished_target_valid_unless_the_step_belongs_to_it(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    engine = steps_of(cell)
    engine.run_to(engine.order.find(f"out:{FIRST}"))
    engine.run_step(engine.order.find("place"))
    assert engine.case.stands(StepKey("target", FIRST))
    assert str(engine.upcoming) == f"target:{LAST}"
    engine.run_step(engine.order.find(f"target:{FIRST}"))
    assert not engine.case.stands(StepKey("out", FIRST))
    engine.close("left")
    case = read_interrupted_run(tmp_path).restore_case(engine.order)
    assert [one.record for one in case.valid_results] == [one.record for one in cell.case.valid_results]


def test_a_requested_run_ends_at_the_cart_move(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    engine = localizing(cell)
    move_at(cell, f"relocalization:{FIRST}")
    engine.run_to(engine.order.find(f"relocalization:{FIRST}"))
    assert moves_asked(cell) == 1
    assert str(engine.upcoming) == "cart_lock"


def test_an_arm_over_a_head_that_has_moved_goes_home_clear_of_where_it_was(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    engine = localizing(cell)
    engine.run_to(engine.order.find(f"relocalization:{FIRST}"))
    assert not has_head_moved(engine)
    engine.void(StepKey(Correspondence.kind), PatientMoved("the head has moved"))
    assert has_head_moved(engine)
    surround_arms(engine)
    engine.retreat_home()
    assert cell.workcell.master.place.is_home
    assert not has_head_moved(engine)
