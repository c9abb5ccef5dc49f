"""A scan that cannot be registered is refused: with a code, a reason and what to do."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.errors import BAD_POINTS
from procedures.registration.surface.checks import SurfaceLimits, require_skin, require_start
from procedures.registration.surface.errors import (
    BAD_SCAN,
    BAD_SURFACE_INPUT,
    FAR_FROM_START,
    HEAD_MOVED,
    LITTLE_COVERAGE,
    MIRRORED_HEAD,
    MUCH_EXCLUDED,
    OTHER_HEAD,
    POORLY_DETERMINED,
    SKIN_CHANGED,
    TWO_POSES,
)
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.settling import Pose
from procedures.registration.surface.spheres import LookedSpheres
from procedures.registration.surface.starts import Start
from procedures.registration.surface.surface_registration import register_surface
from procedures.registration.target_prediction import IndependentErrors, SharedErrors
from ronna_hw.frames import Frame, Transform

FRONT_AND_EARS = ((0.0, -1.0, 0.2), (1.0, -0.6, 0.2), (-1.0, -0.6, 0.2), (0.0, -0.7, 1.0))
VAULT = ((0.0, -0.6, 1.0), (0.0, 0.0, 1.0), (0.5, -0.5, 1.0), (-0.5, -0.5, 1.0))


class Mirrored:
    """A head with left and right exchanged, as a CT of a wrong export shows it."""

    FLIP = np.array([-1.0, 1.0, 1.0])
    voxel_mm = np.eye(3)

    def __init__(self, head) -> None:
        self.head, self.points_mm, self.normals = head, head.points_mm * self.FLIP, head.normals * self.FLIP

    def residuals(self, points_ct_mm):
        distances, normals, valid = self.head.residuals(points_ct_mm * self.FLIP)
        return distances, normals * self.FLIP, valid


@pytest.mark.branch("LITTLE_SKIN")
def test_a_small_patch_is_too_little(heads, scan_of):
    made = scan_of(heads[0], 1, count=300)
    beside = np.linalg.norm(made.truth.inverse().apply(made.scan.points_mm) - [30.0, -80.0, 20.0], axis=1)
    with raises(LITTLE_COVERAGE):
        register_surface(made.scan.select(np.argsort(beside)[:45]), heads[0], made.start)


def test_a_scan_that_leaves_a_target_undetermined_is_refused_with_the_direction(heads, scan_of):
    made = scan_of(heads[0], 2, views=VAULT)
    with raises(POORLY_DETERMINED, match="left to right|front to back|head to feet"):
        register_surface(made.scan, heads[0], made.start, limits=SurfaceLimits(largest_error_mm=0.1))


@pytest.mark.branch("LITTLE_SKIN")
def test_a_round_vault_alone_fits_in_two_poses(heads, scan_of):
    made = scan_of(heads[0], 3, views=VAULT)
    above = made.truth.inverse().apply(made.scan.points_mm)[:, 2] > -10.0
    with raises(TWO_POSES):
        register_surface(made.scan.select(above), heads[0])


@pytest.mark.branch("UNLIKE_SKIN")
def test_another_patient_is_refused(made_head, scan_of):
    made = scan_of(made_head(101), 4)
    other = made_head(102)
    other.axes = (64.0, 104.0, 84.0)
    with raises(OTHER_HEAD):
        register_surface(made.scan, other, made.start)


@pytest.mark.branch("MIRRORED_SKIN")
def test_a_mirrored_ct_is_refused_where_the_head_is_not_symmetric(made_head, scan_of):
    head = made_head(0, side_mm=12.0)
    made = scan_of(head, 5)
    assert register_surface(made.scan, head, made.start).side_proven
    with raises(MIRRORED_HEAD):
        register_surface(made.scan, Mirrored(head), made.start, limits=SurfaceLimits(largest_residual_mm=3.0))


def test_a_place_without_a_surface_does_not_make_a_ct_mirrored(heads, scan_of):
    class Folded:
        """Head whose left ear is no surface in the CT."""

        points_mm, normals, voxel_mm = heads[0].points_mm, heads[0].normals, heads[0].voxel_mm

        def residuals(self, points_ct_mm):
            distances, normals, valid = heads[0].residuals(points_ct_mm)
            return distances, normals, valid & (points_ct_mm[:, 0] < heads[0].axes[0])

    made = scan_of(heads[0], 6)
    assert not register_surface(made.scan, Folded(), made.start).side_proven


def test_a_symmetric_head_does_not_prove_its_side(heads, scan_of):
    made = scan_of(heads[0], 6)
    assert not register_surface(made.scan, heads[0], made.start).side_proven


@pytest.mark.branch("LOOKS_DISAGREE")
def test_a_head_that_moved_between_two_looks_is_refused(heads, scan_of):
    def move(points, look):
        return points + np.where(look >= 2, 1.0, 0.0)[:, None] * [0.7, 0.7, 0.5]

    made = scan_of(heads[0], 7, moved=move, misfit_mm=0.1)
    with raises(HEAD_MOVED, match="from look 2 on"):
        register_surface(made.scan, heads[0], made.start)


@pytest.mark.parametrize("axis", range(3))
def test_a_slip_between_two_looks_at_the_same_skin_is_told_along_every_axis(heads, scan_of, axis):
    def slip(points, look):
        return points + np.where(look == 4, 1.2, 0.0)[:, None] * np.eye(3)[axis]

    looks = (*FRONT_AND_EARS, FRONT_AND_EARS[0])
    still, slipped = (
        scan_of(heads[0], 7, misfit_mm=0.3, count=700, views=looks, moved=moved) for moved in (None, slip)
    )
    register_surface(still.scan, heads[0], still.start)
    with raises(HEAD_MOVED, match="from look 4 on"):
        register_surface(slipped.scan, heads[0], slipped.start)


@pytest.mark.branch("SKIN_MOVED")
def test_skin_that_moved_over_a_third_is_refused_by_name(heads, scan_of):
    made = scan_of(
        heads[0], 8, misfit_mm=0.1, outwards=lambda places: np.where(places[:, 0] > 15.0, 1.5, 0.0)
    )
    with raises(SKIN_CHANGED, match="left temple"):
        register_surface(made.scan, heads[0], made.start)


@pytest.mark.parametrize("refusal", [OTHER_HEAD, SKIN_CHANGED, HEAD_MOVED], ids=lambda one: one.code)
def test_the_clamp_is_named_where_a_head_that_slipped_looks_like_that(refusal):
    assert "clamp" in refusal.action


def test_eyes_that_swell_are_named(heads, scan_of):
    def swell(places):
        middle = np.abs(places[:, 0]) < 55.0
        return np.where(middle & (places[:, 1] < -40.0) & (np.abs(places[:, 2] + 36.0) < 16.0), 1.5, 0.0)

    made = scan_of(heads[0], 9, count=300, misfit_mm=0.1, outwards=swell)
    found = register_surface(made.scan, heads[0], made.start)
    assert found.changed is not None
    assert "eyes" in found.changed.parts
    assert np.linalg.norm(made.errors_mm(found.robot_from_ct), axis=1).max() < 0.6


def test_a_start_that_was_wrong_is_said(heads, scan_of):
    made = scan_of(heads[1], 11)
    aside = RigidTransform.from_translation([15.0, 0.0, 0.0])
    wrong = Start(Transform(Frame.ROBOT, Frame.CT, made.truth.rigid * aside), 0.01, 1.0)
    with raises(FAR_FROM_START):
        register_surface(made.scan, heads[1], wrong)


@pytest.mark.parametrize("axis", range(3))
def test_a_pose_turned_further_than_the_landmarks_err_is_refused(heads, axis):
    landmarks = np.array([[0.0, -130.0, -30.0], [80.0, 0.0, -30.0], [-80.0, 0.0, -30.0]])
    start = Start.from_landmarks(landmarks, landmarks, 4.0)
    for turn_deg, is_refused in ((3.0, False), (9.4, True)):
        turn = np.asarray(Rotation.from_rotvec(np.radians(turn_deg) * np.eye(3)[axis]).as_matrix())
        pose, axes = Pose(turn, landmarks.mean(axis=0) @ (np.eye(3) - turn.T)), HeadAxes.of(heads[0])
        with raises(FAR_FROM_START) if is_refused else nullcontext():
            require_start(pose, start, axes)


def test_a_scan_that_is_mostly_hair_is_refused(heads, scan_of):
    made = scan_of(heads[0], 12, outwards=lambda places: np.where(places[:, 2] > 0.0, 5.0, 0.0))
    with raises(MUCH_EXCLUDED, OTHER_HEAD):
        register_surface(made.scan, heads[0], made.start)


def test_too_much_that_is_no_skin_is_refused():
    with raises(MUCH_EXCLUDED, match="40%"):
        require_skin(np.arange(10) < 4, SurfaceLimits())


def test_numbers_that_mean_nothing_are_refused(heads, scan_of):
    made, no_look = scan_of(heads[0], 14), SharedErrors("arm", np.zeros((2, 3, 1)), np.zeros((3, 1)))
    spoilt = made.scan.points_mm.copy()
    spoilt[3, 1] = np.nan
    with raises(BAD_SCAN):
        type(made.scan)(spoilt, made.scan.covariance_mm2, made.scan.look, made.scan.line, made.scan.view_mm)
    with raises(BAD_POINTS):
        register_surface(made.scan, heads[0], made.start, targets_ct_mm=[np.nan, 0.0, 0.0])
    with raises(BAD_SURFACE_INPUT):
        register_surface(made.scan, heads[0], made.start, arm=[no_look])
    with raises(BAD_SURFACE_INPUT):
        Start(made.truth, np.nan, 1.0)
    looks = len(np.unique(made.scan.look))
    with raises(BAD_SURFACE_INPUT, match="negative"):
        negative = IndependentErrors("arm", np.tile(-np.eye(3), (looks, 1, 1)), np.eye(3))
        register_surface(made.scan, heads[0], made.start, arm=[negative])
    with raises(BAD_SURFACE_INPUT, match="positive definite"):
        LookedSpheres(np.array([0]), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((3, 3)))


@pytest.mark.parametrize("code", range(1, 12))
def test_every_code_says_what_to_do(code):
    from ronna_hw.errors import find_code

    entry = find_code(f"SRF-{code:03}")
    assert entry is not None
    assert entry.action
