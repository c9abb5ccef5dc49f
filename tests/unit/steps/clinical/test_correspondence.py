"""Pairing of CT and measured spheres: a unique answer continues, anything else stops with its reason."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from clinical_case import (
    CENTRES_CT_MM,
    ROBOT_FROM_CT,
    SCENE,
    SPHERES_MM,
    TRACKER_MM,
    ClinicalCell,
    SeeingTracker,
)
from coded_errors import raises
from prepared_results import checked_plan, global_localization, localized_fiducials
from recording_cell import RecordingOperator
from scanned_head import scanned_spheres
from scipy.spatial.transform import Rotation

from procedures.engine.case import Stored
from procedures.engine.methods import CaseMethods, Matcher
from procedures.guards.errors import BaseShifted
from procedures.imaging.localizers import LOCALIZERS
from procedures.operator.question import Topic
from procedures.planning.plan_model import FiducialKind, PatientPosition
from procedures.registration.correspondence import MatchStatus
from procedures.registration.errors import NO_UNIQUE_MATCH, HeadElsewhere
from procedures.registration.room_prior import READING_LIMIT_MM, Landmark, choose_landmark
from procedures.steps.catalogue import clinical_steps
from procedures.steps.clinical import correspondence
from procedures.steps.clinical.coarse_match import SIGMA_CT_MM, coarse_match, room_prior
from procedures.steps.clinical.correspondence import READ_AGAIN, STEP, Correspondence
from procedures.steps.clinical.plan_check import CheckedPlan
from ronna_hw.arrays import Array
from ronna_hw.config import ProcedureSettings
from ronna_hw.errors import EXIT_REFUSED
from ronna_hw.frames import Frame, Transform
from ronna_hw.x_frame import SPHERE_CENTRES_MM

GHOST_MM = np.array([[400.0, 300.0, 200.0]])
# On forehead and vertex: gravity allows each of its turns.
FLAT_MM = np.array([[60.0, 0.0, 0.0], [0.0, 60.0, 0.0], [-60.0, 0.0, 0.0], [0.0, -60.0, 0.0]])
ABOVE_MM = np.add(SCENE.head.centre_ct_mm, (0.0, -75.0, 75.0))
SQUARE_CT_MM = FLAT_MM @ Rotation.from_euler("x", 45.0, degrees=True).as_matrix().T + ABOVE_MM
SQUARE_MM = ROBOT_FROM_CT.apply(SQUARE_CT_MM)


def match_with(cell: ClinicalCell, room_mm: Array, ct_mm: Array = CENTRES_CT_MM) -> Stored[Correspondence]:
    return cell.run(localized_fiducials(ct_mm), global_localization(room_mm), checked_plan(), STEP)


def test_spheres_are_paired_regardless_of_the_order_in_which_the_tracker_saw_them(cell: ClinicalCell) -> None:
    stored = match_with(cell, np.vstack([SPHERES_MM[[2, 0]], GHOST_MM, SPHERES_MM[[3, 1]]]))
    found = stored.result
    assert found.status is MatchStatus.UNIQUE
    assert sorted(found.pairs) == [(0, 1), (1, 4), (2, 0), (3, 3)]
    assert found.robot_from_ct.transform.target is Frame.ROBOT
    np.testing.assert_allclose(
        found.robot_from_ct.transform.as_matrix(), ROBOT_FROM_CT.as_matrix(), atol=1e-6
    )
    assert found.two_way.unmatched_room == (("tracker", 2),)
    assert (found.matcher, found.e_mm, found.refused_share) == (Matcher.OURS, None, None)
    parents = {name.partition("-")[2] for name in stored.record.parents}
    assert parents == {"fiducial_localization", "global_localization", "plan_check"}


def test_a_sphere_that_a_scan_does_not_show_is_not_paired_and_the_others_keep_their_numbers(
    cell: ClinicalCell,
) -> None:
    before, made = localized_fiducials(), scanned_spheres()
    shown = tuple(
        one.model_copy(update={"fiducial": index})
        for one, index in zip(made.spheres[1:], (0, 2, 3), strict=True)
    )
    scan = made.model_copy(update={"markers": before.markers, "spheres": shown})
    steps = {step.name: step for step in clinical_steps(intraoperative=True)}
    stored = cell.run(scan, global_localization(SPHERES_MM), checked_plan(), steps["correspondence"])
    found = stored.result
    assert isinstance(found, Correspondence)
    assert sorted(found.pairs) == [(0, 0), (2, 2), (3, 3)]  # the tracker sees the other as well
    assert found.two_way.unmatched_ct == (1,)
    assert found.two_way.unmatched_room == (("tracker", 1),)


def implanted_by(template_mm: Array) -> CheckedPlan:
    """The plan of a head whose markers a template placed."""
    planned = checked_plan()
    changes = {"implanted": len(template_mm), "template_mm": tuple(map(tuple, template_mm.tolist()))}
    return planned.model_copy(
        update={"plan": planned.plan.model_copy(update=changes), "implanted": len(template_mm)}
    )


def test_a_template_finds_its_spheres_among_others_in_ct_and_room(cell: ClinicalCell) -> None:
    more = np.array([[30.0, -20.0, 55.0]])  # a sphere that is no marker, in the CT only
    template = CENTRES_CT_MM[:3][[1, 2, 0]] - CENTRES_CT_MM[0]
    planned = implanted_by(template)
    seen = np.vstack([GHOST_MM, SPHERES_MM[:3]])
    ct = localized_fiducials(np.vstack([CENTRES_CT_MM[:3], CENTRES_CT_MM[:1] + more]))
    found = cell.run(ct, global_localization(seen), planned, STEP).result
    assert found.status is MatchStatus.UNIQUE
    assert sorted(found.pairs) == [(0, 1), (1, 2), (2, 3)]


def test_spheres_off_their_template_places_are_not_paired(cell: ClinicalCell) -> None:
    planned = implanted_by(1.1 * CENTRES_CT_MM[:3])
    with raises(NO_UNIQUE_MATCH, match="the template among the image points"):
        cell.run(localized_fiducials(CENTRES_CT_MM[:3]), global_localization(SPHERES_MM[:3]), planned, STEP)


@pytest.mark.parametrize("matcher", Matcher)
@pytest.mark.parametrize(
    ("room_mm", "ct_mm", "status", "candidates"),
    [
        (SPHERES_MM[:2], CENTRES_CT_MM, MatchStatus.TOO_FEW, 0),
        (1.2 * SPHERES_MM, CENTRES_CT_MM, MatchStatus.INCONSISTENT, 0),
        pytest.param(SQUARE_MM, SQUARE_CT_MM, MatchStatus.AMBIGUOUS, 2, marks=pytest.mark.hazard(10)),
    ],
)
@pytest.mark.branch("AMBIGUOUS")
def test_anything_but_a_unique_answer_stops_with_its_reason_and_shows_the_candidates(
    cell: ClinicalCell, room_mm: Array, ct_mm: Array, status: MatchStatus, candidates: int, matcher: Matcher
) -> None:
    cell.methods = CaseMethods(matcher=matcher)
    with raises(NO_UNIQUE_MATCH, match=f"REG-008: the correspondence is {status}: ") as caught:
        match_with(cell, room_mm, ct_mm)
    assert cell.operator.asked == []
    shown = candidates if matcher is Matcher.OURS else 0
    assert (caught.value.got or "").count("image-physical") == shown


FIFTH_MM = CENTRES_CT_MM.mean(axis=0) + np.array([20.0, -35.0, 30.0])  # one more sphere, where no other is
FIVE_CT_MM = np.vstack([CENTRES_CT_MM[:2], FIFTH_MM, CENTRES_CT_MM[2:]])
FIVE_MM = ROBOT_FROM_CT.apply(FIVE_CT_MM)


def match_five(cell: ClinicalCell, room_mm: Array) -> Correspondence:
    planned = checked_plan().model_copy(update={"implanted": 5})
    return cell.run(localized_fiducials(FIVE_CT_MM), global_localization(room_mm), planned, STEP).result


MISPLACED = {
    "missing": np.delete(FIVE_MM, 2, axis=0),
    "displaced": FIVE_MM + np.outer(np.arange(5) == 2, (4.0, -3.0, 2.0)),
}


@pytest.mark.hazard(11)
@pytest.mark.branch("UNMATCHED_SPHERE")
@pytest.mark.parametrize("what", MISPLACED)
def test_a_sphere_out_of_place_is_left_out_when_the_operator_agrees(cell: ClinicalCell, what: str) -> None:
    found = match_five(cell, MISPLACED[what])
    (question,) = cell.operator.asked
    assert question.subject.startswith("sphere 3 of the CT is missing")
    assert "3: the tracker sees nothing within" in question.value
    assert [pair[0] for pair in found.pairs] == [0, 1, 3, 4]
    assert [one.fiducial for one in found.left_out] == [2]


@pytest.mark.hazard(11)
@pytest.mark.branch("UNMATCHED_SPHERE")
def test_a_case_with_a_sphere_out_of_place_is_refused_without_consent(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.UNMATCHED_SPHERE)
    with raises(NO_UNIQUE_MATCH, match="5 image and 4 physical points"):
        match_five(cell, MISPLACED["missing"])


@pytest.mark.hazard(11)
def test_no_sphere_is_left_out_of_four(cell: ClinicalCell) -> None:
    with raises(NO_UNIQUE_MATCH):
        match_with(cell, SPHERES_MM[:3])
    assert cell.operator.asked == []


def test_the_frame_is_matched_by_its_layout_and_other_spheres_are_ignored(cell: ClinicalCell) -> None:
    planned = checked_plan()
    framed = planned.model_copy(
        update={"plan": planned.plan.model_copy(update={"fiducials": FiducialKind.XFRAME})}
    )
    frame_ct_mm = np.array(SPHERE_CENTRES_MM) + CENTRES_CT_MM[0]
    ct = np.vstack([frame_ct_mm[[2, 0]], FIFTH_MM, frame_ct_mm[[3, 1]]])
    room = np.vstack([ROBOT_FROM_CT.apply(frame_ct_mm), GHOST_MM])
    found = cell.run(localized_fiducials(ct), global_localization(room), framed, STEP).result
    assert sorted(found.pairs) == [(0, 2), (1, 0), (3, 3), (4, 1)]


# Flat and beside the head's middle: the tracker would see them past a mirrored head as well.
BESIDE_CT_MM = (
    np.array([[-60.0, -75.0, 30.0], [-45.0, -70.0, 75.0], [-80.0, 5.0, 60.0]]) + SCENE.head.centre_ct_mm
)
BESIDE_MM = ROBOT_FROM_CT.apply(BESIDE_CT_MM)


def match_beside(cell: ClinicalCell) -> Correspondence:
    planned = checked_plan().model_copy(update={"implanted": 3})
    return cell.run(localized_fiducials(BESIDE_CT_MM), global_localization(BESIDE_MM), planned, STEP).result


def test_a_point_of_the_head_is_touched_where_a_mirrored_ct_would_match_as_well(cell: ClinicalCell) -> None:
    touched = match_beside(cell).touched
    assert touched is not None
    (task,) = cell.room.worked
    assert touched.landmark in task.subject
    assert touched.off_mm < 1.0 < touched.mirrored_mm
    assert cell.case.get(Correspondence).result.touched == touched


@pytest.mark.hazard(7)
@pytest.mark.branch("MIRRORED_CT")
@pytest.mark.parametrize("reading", ["mirrored", "beside the mirrored", "in cm"])
def test_a_head_touched_elsewhere_stops_the_case_and_a_mistyped_reading_is_not_called_a_mirrored_ct(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch, reading: str
) -> None:
    def choose(*asked: Any) -> Landmark | None:
        landmark = choose_landmark(*asked)
        assert landmark is not None
        mirrored_mm = landmark.mirrored_mm[0]
        touched_mm = {
            "mirrored": mirrored_mm,
            "beside the mirrored": np.add(mirrored_mm, (0.0, 0.0, 0.9 * READING_LIMIT_MM)),
            "in cm": 0.1 * landmark.matched_mm,
        }[reading]
        cell.room.touched = lambda _side: tuple(touched_mm)
        return landmark

    monkeypatch.setattr(correspondence, "choose_landmark", choose)
    with pytest.raises(HeadElsewhere) as refused:
        match_beside(cell)
    assert refused.value.code == "REG-013"
    assert refused.value.exit_code == EXIT_REFUSED
    assert (refused.value.action == READ_AGAIN) == (reading == "in cm")
    assert ("left and right" in refused.value.action) == (reading != "in cm")


def test_a_point_touched_elsewhere_is_told_by_distance_and_side_not_by_what_to_type(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    def choose(*asked: Any) -> Landmark | None:
        landmark = choose_landmark(*asked)
        assert landmark is not None
        off_mm = ROBOT_FROM_CT.apply((90.0, 0.0, 20.0)) - ROBOT_FROM_CT.apply((0.0, 0.0, 0.0))  # LPS
        cell.room.touched = lambda _side: tuple(landmark.matched_mm + off_mm)
        return landmark

    monkeypatch.setattr(correspondence, "choose_landmark", choose)
    with pytest.raises(HeadElsewhere, match="got 92 mm away, toward the patient's left") as refused:
        match_beside(cell)
    assert refused.value.expected is None


@pytest.mark.hazard(13)
def test_a_head_touched_elsewhere_because_the_cart_was_moved_is_no_mirrored_ct(cell: ClinicalCell) -> None:
    assert isinstance(cell.tracker, SeeingTracker)
    cell.tracker.spheres_mm = BESIDE_MM
    cell.tracker.frame_shift_mm = (60.0, -40.0, 0.0)
    cell.room.touched = lambda _side: (760.0, 0.0, 500.0)
    with pytest.raises(BaseShifted, match="PRO-019: the cart"):
        match_beside(cell)
    assert cell.entries("voided") == [("voided", "global_localization")]


@pytest.mark.hazard(7)
@pytest.mark.parametrize("position", ["HFP", "FFP", "HFDR", "HFDL"])
def test_a_plan_for_another_patient_position_than_gravity_allows_is_refused(
    cell: ClinicalCell, position: str
) -> None:
    planned = checked_plan()
    other = planned.plan.model_copy(update={"patient_orientation": PatientPosition(position)})
    with raises(NO_UNIQUE_MATCH, match=r"turned \d+ deg beyond the planned patient position, limit 30 deg"):
        cell.run(
            localized_fiducials(), global_localization(), planned.model_copy(update={"plan": other}), STEP
        )


def test_a_patient_may_lie_on_the_table_otherwise_than_in_the_scanner(cell: ClinicalCell) -> None:
    planned = checked_plan()
    scanned_prone = {"patient_orientation": PatientPosition.HFP, "table_position": PatientPosition.HFS}
    planned = planned.model_copy(update={"plan": planned.plan.model_copy(update=scanned_prone)})
    found = cell.run(localized_fiducials(), global_localization(), planned, STEP).result
    assert found.status is MatchStatus.UNIQUE


@pytest.mark.hazard(7)
@pytest.mark.parametrize(("recline_deg", "accepted"), [((0.0, 60.0), True), ((0.0, 10.0), False)])
def test_how_far_a_patient_may_be_reclined_is_stated_by_the_theatre_file(
    recline_deg: tuple[float, float], accepted: bool
) -> None:
    settings = ProcedureSettings(recline_deg=recline_deg)
    tracker = Transform.of(Frame.ROBOT, Frame.TRACKER, translation_mm=TRACKER_MM)
    found = coarse_match(
        checked_plan(),
        localized_fiducials(),
        SPHERES_MM,
        room_prior(checked_plan(), settings, tracker),
        CaseMethods(),
    )
    assert (found.status is MatchStatus.UNIQUE) is accepted


def by_thesis(cell: ClinicalCell, e_mm: float = 2.5) -> ClinicalCell:
    cell.methods = CaseMethods(matcher=Matcher.THESIS, e_mm=e_mm, refused_share=0.01)
    return cell


def test_the_thesis_matcher_pairs_the_spheres_and_its_settings_are_stored(cell: ClinicalCell) -> None:
    found = match_with(by_thesis(cell), np.vstack([SPHERES_MM[[2, 0]], GHOST_MM, SPHERES_MM[[3, 1]]])).result
    assert sorted(found.pairs) == [(0, 1), (1, 4), (2, 0), (3, 3)]
    assert (found.matcher, found.e_mm, found.refused_share) == (Matcher.THESIS, 2.5, 0.01)
    assert found.margin_nats is None


@pytest.mark.hazard(11)
@pytest.mark.branch("UNMATCHED_SPHERE")
def test_the_thesis_matcher_leaves_a_missing_sphere_out_but_states_no_odds(cell: ClinicalCell) -> None:
    found = match_five(by_thesis(cell), MISPLACED["missing"])
    (question,) = cell.operator.asked
    assert "the thesis' matcher states no odds" in question.value
    assert [one.fiducial for one in found.left_out] == [2]


def test_the_thesis_matcher_refuses_a_displaced_sphere_without_finding_which_it_is(
    cell: ClinicalCell,
) -> None:
    with raises(NO_UNIQUE_MATCH, match=r"fewer than 5 spheres have distances .* within e = 2\.5 mm"):
        match_five(by_thesis(cell), MISPLACED["displaced"])


@pytest.mark.hazard(7)
def test_a_pairing_of_the_thesis_is_refused_where_gravity_excludes_its_orientation() -> None:
    tracker = Transform.of(Frame.ROBOT, Frame.TRACKER, translation_mm=TRACKER_MM)
    prior = room_prior(checked_plan(), ProcedureSettings(recline_deg=(0.0, 10.0)), tracker)
    methods = CaseMethods(matcher=Matcher.THESIS)
    found = coarse_match(checked_plan(), localized_fiducials(), SPHERES_MM, prior, methods)
    assert found.status is MatchStatus.INCONSISTENT
    assert "that the prior excludes" in found.reason


@pytest.mark.parametrize(
    "published_mm", [one.published_mm for one in LOCALIZERS.values() if one.published_mm is not None]
)
def test_a_published_error_is_within_the_one_that_the_matching_assumes(published_mm: float) -> None:
    assert published_mm / np.sqrt(3.0) <= SIGMA_CT_MM
