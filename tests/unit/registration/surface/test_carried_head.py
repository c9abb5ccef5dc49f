"""A registration that the clamp carries: corrected by a few looks, or contradicted by them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.surface.errors import CARRIED_DIFFERS
from procedures.steps.clinical.correspondence import SurfaceStart
from procedures.steps.clinical.fiducial_localization import SkinInCt
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.results import RegisteredBySurface, ScannedSurface
from procedures.steps.clinical.surface import carried_head
from procedures.steps.clinical.surface.carried_head import (
    CarriedHead,
    correct_carried,
    find_carried,
    tell_whole_scan,
)
from ronna_hw.frames import Frame, Transform

TARGETS_MM = np.array([[-20.0, -20.0, -20.0], [0.0, 40.0, 0.0]])
CLAMP_ERROR = RigidTransform.from_components([0.3, -0.2, 0.2], Rotation.from_rotvec([0.002, -0.002, 0.001]))


def scanned_again(made, shift_mm=np.zeros_like):
    """Scan again where the clamp's error has the head, with other noise; the skin moved by what is given."""
    places = made.truth.inverse().apply(made.scan.points_mm)
    now = made.truth.rigid * CLAMP_ERROR
    noise = np.random.default_rng(5).normal(size=places.shape) * 0.05
    scan = made.scan
    moved = now.apply(places + shift_mm(places) + noise)
    return type(scan)(moved, scan.covariance_mm2, scan.look, scan.line, scan.view_mm), now


def carried(made, scan):
    return CarriedHead("12-surface_registration", None, scan, made.truth, 1.0)


def test_looks_at_skin_scanned_before_correct_the_error_of_the_clamp(heads, scan_of):
    made = scan_of(heads[0], 31, count=300, misfit_mm=0.3)
    seen, now = scanned_again(made)
    pose, errors = correct_carried(carried(made, made.scan), seen, heads[0], TARGETS_MM)
    before = np.linalg.norm(now.apply(TARGETS_MM) - made.truth.apply(TARGETS_MM), axis=1)
    after = np.linalg.norm(now.apply(TARGETS_MM) - pose.apply(TARGETS_MM), axis=1)
    assert (after < 0.5 * before).all()
    assert (after < [one.limit_mm(0.999) for one in errors]).all()


@pytest.mark.branch("CARRIED_ELSEWHERE")
def test_skin_that_slipped_contradicts(heads, scan_of):
    def slip(places):
        near = np.linalg.norm(places - [40.0, -65.0, -58.0], axis=1) < 28.0
        return 1.2 * near[:, None] * heads[0].find_normals(places)

    made = scan_of(heads[0], 32, count=300)
    with raises(CARRIED_DIFFERS, match="skin has moved"):
        correct_carried(carried(made, made.scan), scanned_again(made, slip)[0], heads[0], TARGETS_MM)


@pytest.mark.branch("CARRIED_ELSEWHERE")
def test_a_head_that_slipped_in_its_clamp_contradicts(heads, scan_of):
    made = scan_of(heads[0], 33, count=300)
    seen, _ = scanned_again(made, lambda places: np.tile([0.0, 3.0, 0.0], (len(places), 1)))
    with raises(CARRIED_DIFFERS, match="not where its clamp"):
        correct_carried(carried(made, made.scan), seen, heads[0], TARGETS_MM)


@pytest.mark.branch("CARRIED_ELSEWHERE")
def test_looks_at_other_skin_confirm_nothing(heads, scan_of):
    made = scan_of(heads[0], 34, count=300)
    left = made.truth.inverse().apply(made.scan.points_mm)[:, 0]
    seen, _ = scanned_again(made)
    with raises(CARRIED_DIFFERS, match="share too little"):
        correct_carried(
            carried(made, made.scan.select(left > 15.0)), seen.select(left < -15.0), heads[0], TARGETS_MM
        )


class Before:
    """A case whose head was registered by a whole scan before its clamp moved."""

    def __init__(self, scan, turn_rad=0.01, way_mm=3.0, markers=(), refused=False):
        def localized(pose):
            framed = SimpleNamespace(transform=pose)
            base = SimpleNamespace(transform=Transform.of(Frame.ROBOT, Frame.TRACKER))
            return SimpleNamespace(robot_from_tracker=base, tracker_from_patient=framed)

        def frame(turn, way):
            return Transform(
                Frame.TRACKER,
                Frame.PATIENT,
                RigidTransform.from_components([way, 0.0, 0.0], Rotation.from_rotvec([0.0, 0.0, turn])),
            )

        pose = SimpleNamespace(transform=Transform.of(Frame.ROBOT, Frame.CT))
        whole = SimpleNamespace(carried=False, robot_from_ct=pose)
        record = SimpleNamespace(identifier="12-surface_registration", parents={})
        start = SimpleNamespace(carried=record.identifier if refused else None)
        self._now = {
            GlobalLocalization: localized(frame(turn_rad, way_mm)),
            SkinInCt: SimpleNamespace(markers=markers),
        }
        self._then = {
            GlobalLocalization: localized(frame(0.0, 0.0)),
            SkinInCt: None,
            ScannedSurface: SimpleNamespace(scan=scan),
        }
        self._former = {
            RegisteredBySurface: [SimpleNamespace(record=record, result=whole)],
            SurfaceStart: [
                SimpleNamespace(record=SimpleNamespace(identifier="15-surface_start"), result=start)
            ],
        }
        self.found = []
        self.find = self.found.append
        self.result, self.former = self._now.__getitem__, self._former.__getitem__

    def former_ancestor(self, _record, model):
        record = SimpleNamespace(identifier="02-skin_in_ct")
        return SimpleNamespace(record=record, result=self._then[model])

    def identifier(self, _model):
        return "02-skin_in_ct"


@pytest.fixture
def case(monkeypatch, heads, scan_of):
    monkeypatch.setattr(carried_head, "skin_of", lambda _context: heads[0])
    scan = scan_of(heads[0], 35, count=60).scan
    return lambda **changes: Before(scan, **changes)


def test_the_scan_goes_with_the_frame_on_the_clamp(case):
    before = case(turn_rad=0.0, way_mm=3.0)
    found = find_carried(before)
    assert found.way_mm == pytest.approx(3.0)
    assert found.robot_from_ct.translation_mm == pytest.approx([3.0, 0.0, 0.0])
    moved = found.scan.points_mm - before._then[ScannedSurface].scan.points_mm
    assert moved == pytest.approx(np.tile([3.0, 0.0, 0.0], (len(moved), 1)))


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"way_mm": 60.0}, "moved by 60 mm"),
        ({"turn_rad": 0.3}, "and 17 deg, and carries a registration by at most 30 mm and 10 deg"),
        ({"markers": ("sphere",)}, "beside spheres"),
        ({"refused": True}, "contradicted"),
    ],
    ids=["far", "turned", "spheres", "contradicted before"],
)
def test_else_the_whole_skin_is_scanned_and_the_case_says_why(case, changes, why):
    before = case(**changes)
    assert find_carried(before) is None
    tell_whole_scan(before)
    (said,) = before.found
    assert "the whole skin is scanned" in said
    assert why in said


def test_nothing_is_said_of_a_first_scan_and_of_a_carried_head(case):
    moved, first = case(), case(markers=("sphere",))
    first._former[RegisteredBySurface] = []
    for one in (moved, first):
        tell_whole_scan(one)
        assert one.found == []
