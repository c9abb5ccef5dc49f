"""Head and robot base after a restart, compared with the record as a step compares them at rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from clinical_case import ClinicalCell, SeeingTracker
from prepared_results import coarse
from pushed_tracker import localized_by_frame, with_patient_frame
from recording_cell import HOME

from procedures.engine.engine import Engine
from procedures.runs import recovery
from procedures.runs.comparison import Comparison, compare_room
from procedures.workcell import MountedTool
from ronna_hw.devices.readings import TrackerFrame, Validity

pytestmark = pytest.mark.hazard(2)


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path / "run").carrying(MountedTool.STEREO_HEAD)


def localized(cell: ClinicalCell, count: int = 2) -> Engine:
    engine = cell.begin(*coarse()[:count])
    engine.run_to()
    return engine


def compared(engine: Engine) -> tuple[bool, Comparison]:
    comparison = Comparison()
    return compare_room(engine, comparison), comparison


@pytest.mark.parametrize("count", [1, 2])  # results that stand: the localization, and what is matched
def test_an_unchanged_room_is_reported_with_its_figures(cell: ClinicalCell, count: int) -> None:
    seen, comparison = compared(localized(cell, count))
    assert seen
    assert comparison.differences == []
    assert comparison.findings == [
        "patient: spheres within 0.00 mm of their recorded positions",
        "robot base: the frame on the arm within 0.00 mm of where it is expected",
    ]
    assert cell.tracker.calls == ["activate", "deactivate"]


def move_head(by_mm: float) -> Callable[[SeeingTracker], None]:
    def move(tracker: SeeingTracker) -> None:
        tracker.spheres_mm = tracker.spheres_mm + np.array([by_mm, 0.0, 0.0])

    return move


def move_frame(tracker: SeeingTracker) -> None:
    tracker.frame_shift_mm = (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("move", "said"),
    [
        (move_head(0.35), "the head, or the tracker, has moved"),  # who knows how the arm came to rest
        (move_head(30.0), "the head has moved"),  # no sphere is near its place: known by their layout
        (move_frame, "somebody leans on arm or guide: the frame on the arm by 1.00 mm"),
    ],
)
def test_what_has_moved_meanwhile_is_told_and_voids_what_depends_on_it(
    cell: ClinicalCell, move: Callable[[SeeingTracker], None], said: str
) -> None:
    engine = localized(cell)
    move(cell.tracker)
    seen, comparison = compared(engine)
    assert seen
    assert comparison.differences == []
    assert said in comparison.warnings[0]
    assert engine.case.stands(engine.order.find("global_localization"))  # until it is accepted
    recovery._void_moved(engine, comparison)
    assert not engine.case.stands(engine.order.find("global_localization"))


@pytest.mark.hazard(12)
def test_what_has_moved_meanwhile_is_a_difference_while_an_arm_is_out(cell: ClinicalCell) -> None:
    engine = localized(cell)
    move_head(30.0)(cell.tracker)
    cell.arm.joints_rad = HOME
    engine.compare_places()
    _, comparison = compared(engine)
    assert "the head has moved" in comparison.differences[0]
    assert comparison.moved is None


def test_two_spheres_are_too_few_for_a_comparison(cell: ClinicalCell) -> None:
    engine = localized(cell)
    cell.tracker.spheres_mm = cell.tracker.spheres_mm[:2]
    seen, comparison = compared(engine)
    assert not seen
    assert comparison.differences == []


def test_a_head_without_spheres_is_compared_by_the_frame_on_its_clamp_and_the_finding_says_so(
    cell: ClinicalCell,
) -> None:
    tracker = with_patient_frame(cell, MountedTool.STEREO_HEAD)
    tracker.spheres_mm = np.empty((0, 3))
    here = localized_by_frame()[0].model_copy(update={"points": ()})
    engine = cell.begin(here)
    engine.run_to()
    seen, comparison = compared(engine)
    assert seen
    assert comparison.findings[0] == (
        "patient: the frame on the clamp within 0.00 mm of its recorded position; "
        "the head in the clamp was not compared"
    )


class WithoutFrame(SeeingTracker):
    """Something stands between tracker and frame."""

    def read_frame(self, timeout_s: float = 1.0) -> TrackerFrame:
        frame = super().read_frame(timeout_s)
        lost = replace(frame.tools[0], validity=Validity.MISSING)
        return replace(frame, tools=(lost, *frame.tools[1:]))


def test_the_frame_on_the_arm_must_be_seen_when_the_arm_is_home(cell: ClinicalCell) -> None:
    engine = localized(cell)
    cell.opened.replace_tracker(WithoutFrame("tracker", state=cell.tracker.state, cell=cell))
    _, comparison = compared(engine)
    assert "the tracker does not see it" in comparison.differences[0]


@pytest.mark.parametrize(
    ("hidden", "said"),
    [
        (False, "robot base: the frame on the arm within 0.00 mm of where it is expected"),
        (True, "robot base: the tracker does not see the frame on the arm; compared once it is home"),
    ],
)
def test_the_base_is_compared_as_well_while_the_arm_is_away_from_home_if_its_frame_is_seen(
    cell: ClinicalCell, hidden: bool, said: str
) -> None:
    engine = localized(cell)
    cell.arm.joints_rad = HOME
    engine.compare_places()
    cell.tracker.hidden = hidden
    _, comparison = compared(engine)
    assert comparison.differences == []
    assert said in comparison.findings


@pytest.mark.hazard(13)
def test_a_cart_that_was_plainly_moved_is_a_difference_in_any_pose(cell: ClinicalCell) -> None:
    engine = localized(cell)
    cell.arm.joints_rad = HOME
    engine.compare_places()
    cell.tracker.frame_shift_mm = (12.0, 0.0, 0.0)
    _, comparison = compared(engine)
    assert "the cart of the robot was moved" in comparison.differences[0]


def test_nothing_is_compared_before_the_localization(cell: ClinicalCell) -> None:
    seen, comparison = compared(cell.begin(*coarse()))
    assert seen
    assert comparison.differences == []
    assert cell.tracker.frames_read == 0
