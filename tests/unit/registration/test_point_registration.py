"""The rigid fit: exact on exact data, never a reflection, weighted where errors are known."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration import Caveat, register
from procedures.registration.errors import (
    DUPLICATE_POINTS,
    RESIDUAL_TOO_LARGE,
    UNSOUND_REGISTRATION,
    BadParameter,
    CollinearPoints,
)
from ronna_hw.frames import Frame

EXACT = 1e-12


@pytest.mark.parametrize("count", [3, 4, 5, 8])
def test_exact_points_give_the_exact_transform(count, random, fiducials, any_pose):
    for _ in range(20):
        points, truth = fiducials(count, random), any_pose(random)
        found = register(points, truth.apply(points))
        assert (found.transform.rotation.inv() * truth.rotation).magnitude() < EXACT
        assert np.abs(found.transform.translation - truth.translation).max() < 1e-9
        assert found.fre_mm < 1e-10
        assert found.caveats == ()


@pytest.mark.parametrize("count", [3, 4])
def test_coplanar_points_give_a_proper_rotation(count, random, any_pose):
    square = np.array([[0, 0, 0], [80, 0, 0], [70, 60, 0], [-10, 90, 0]], dtype=float)[:count]
    for _ in range(50):
        truth = any_pose(random)
        measured = truth.apply(square) + random.normal(size=square.shape) * 0.3
        found = register(square, measured)
        assert np.linalg.det(found.transform.as_matrix()[:3, :3]) == pytest.approx(1.0)
        assert (found.transform.rotation.inv() * truth.rotation).magnitude() < 0.05


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(3, 10))
def test_no_point_set_gives_a_reflection(seed, count):
    random = np.random.default_rng(seed)
    image, physical = random.normal(size=(2, count, 3)) * 100.0
    try:
        found = register(image, physical)
    except (CollinearPoints, DUPLICATE_POINTS):
        assume(False)
    assert np.linalg.det(found.transform.as_matrix()[:3, :3]) == pytest.approx(1.0)


def test_the_fit_agrees_with_an_independent_solution(random, fiducials, any_pose):
    for _ in range(20):
        points = fiducials(6, random)
        measured = any_pose(random).apply(points) + random.normal(size=points.shape)
        found = register(points, measured)
        oracle, _ = Rotation.align_vectors(measured - measured.mean(axis=0), points - points.mean(axis=0))
        assert (found.transform.rotation.inv() * oracle).magnitude() < 1e-10
        shift = measured.mean(axis=0) - oracle.apply(points.mean(axis=0))
        assert np.abs(found.transform.translation - shift).max() < 1e-7


def test_the_result_transforms_with_the_frames(random, fiducials, any_pose):
    points, measured = fiducials(5, random), any_pose(random).apply(fiducials(5, random))
    plain, left, right = register(points, measured), any_pose(random), any_pose(random)
    moved = register(right.apply(points), left.apply(measured))
    assert np.allclose(
        (left * plain.transform * right.inv()).as_matrix(), moved.transform.as_matrix(), atol=1e-9
    )
    assert moved.fre_mm == pytest.approx(plain.fre_mm)


def test_residuals_are_measured_minus_mapped_and_fre_is_their_rms(random, fiducials, any_pose):
    points = fiducials(5, random)
    measured = any_pose(random).apply(points) + random.normal(size=points.shape) * 0.4
    found = register(points, measured)
    assert np.allclose(found.residuals_mm, measured - found.transform.apply(points))
    assert found.fre_mm == pytest.approx(np.sqrt(np.square(found.residuals_mm).sum(axis=1).mean()))
    assert np.abs(found.residuals_mm.sum(axis=0)).max() < 1e-9  # gradient of the cost along the shift


def test_equal_covariances_do_not_change_the_fit(random, fiducials, any_pose):
    points = fiducials(5, random)
    measured = any_pose(random).apply(points) + random.normal(size=points.shape) * 0.4
    plain = register(points, measured)
    weighted = register(points, measured, covariance_mm2=np.broadcast_to(np.eye(3) * 0.16, (5, 3, 3)))
    assert np.allclose(plain.transform.as_matrix(), weighted.transform.as_matrix(), atol=1e-9)
    assert weighted.chi_square == pytest.approx(5 * plain.fre_mm**2 / 0.16)


def test_the_weighted_fit_minimises_its_cost(random, fiducials, any_pose):
    points, truth = fiducials(5, random), any_pose(random)
    axes = np.linalg.qr(random.normal(size=(5, 3, 3)))[0]
    spread = np.array([0.2, 0.2, 0.6]) * random.uniform(0.5, 3.0, size=(5, 1))
    covariance = axes @ (np.eye(3) * spread[:, None, :] ** 2) @ axes.transpose(0, 2, 1)
    noise = np.einsum("nij,nj->ni", axes, random.normal(size=(5, 3)) * spread)
    measured = truth.apply(points) + noise
    found = register(points, measured, covariance_mm2=covariance)

    def cost(transform: RigidTransform) -> float:
        rest = measured - transform.apply(points)
        return float(np.einsum("ni,nij,nj->", rest, np.linalg.inv(covariance), rest))

    best = cost(found.transform)
    assert best == pytest.approx(found.chi_square)
    for step in np.vstack([np.eye(6), -np.eye(6)]):
        nearby = RigidTransform.from_components(step[3:] * 1e-3, Rotation.from_rotvec(step[:3] * 1e-5))
        assert cost(nearby * found.transform) > best


@pytest.mark.parametrize(
    ("spread_mm", "least_gain"),
    [
        (np.tile([0.15, 0.15, 0.45], (5, 1)), 0.20),  # 1:1:3, the depth axis of cameras turning with the view
        (np.array([[0.2] * 3] * 4 + [[1.0] * 3]), 0.40),  # one fiducial five times noisier
    ],
)
def test_weighting_lowers_the_target_error(spread_mm, least_gain, random, fiducials, any_pose):
    target = np.array([0.0, 0.0, 10.0])
    errors = {False: [], True: []}
    predicted = []
    for _ in range(150):
        points, truth = fiducials(5, random), any_pose(random)
        axes = np.linalg.qr(random.normal(size=(5, 3, 3)))[0]
        covariance = axes @ (np.eye(3) * spread_mm[:, None, :] ** 2) @ axes.transpose(0, 2, 1)
        measured = truth.apply(points) + np.einsum("nij,nj->ni", axes, random.normal(size=(5, 3)) * spread_mm)
        for weighted in (False, True):
            found = register(points, measured, covariance_mm2=covariance if weighted else None)
            errors[weighted].append(np.linalg.norm(found.transform.apply(target) - truth.apply(target)))
        predicted.append(found.predict_tre_mm(target)[0])
    plain, weighted = (np.sqrt(np.mean(np.square(errors[key]))) for key in (False, True))
    assert weighted < (1.0 - least_gain) * plain
    assert weighted == pytest.approx(np.sqrt(np.mean(np.square(predicted))), rel=0.15)


@pytest.mark.hazard(11)
def test_leave_one_out_reveals_the_fiducial_that_moved(random, fiducials, any_pose):
    points = fiducials(5, random)
    measured = any_pose(random).apply(points) + random.normal(size=points.shape) * 0.05
    measured[3] += [0.0, 2.0, 1.0]
    found = register(points, measured)
    distances = np.array(found.leave_one_out_mm, dtype=float)
    assert distances[3] == pytest.approx(np.hypot(2.0, 1.0), abs=0.4)
    assert not found.gate(fle_mm=0.1).passed


def test_three_pairs_have_no_leave_one_out(random, fiducials):
    points = fiducials(3, random)
    assert register(points, points + 1.0).leave_one_out_mm == (None, None, None)


@pytest.mark.hazard(7)
def test_a_mirrored_set_gets_a_proper_rotation_but_is_not_sound(random, fiducials):
    points = fiducials(6, random)
    found = register(points, points * [-1.0, 1.0, 1.0])
    assert np.linalg.det(found.transform.as_matrix()[:3, :3]) == pytest.approx(1.0)
    assert Caveat.MIRRORED in found.caveats
    with raises(UNSOUND_REGISTRATION, match="REG-009"):
        found.require_sound()


def test_a_mirrored_set_with_equal_axes_is_ill_posed():
    corners = np.array([[a, b, c] for a in (-50, 50) for b in (-50, 50) for c in (-50, 50)], dtype=float)
    assert Caveat.ILL_POSED in register(corners, -corners).caveats


@pytest.mark.hazard(11)
@pytest.mark.parametrize("spoil", [lambda mm: mm[[1, 0, 2, 3, 4]], lambda mm: mm / 10.0])  # rows swapped; cm
def test_residuals_beyond_the_stated_covariances_are_not_sound(random, fiducials, spoil):
    points, covariance = fiducials(5, random), np.tile(np.eye(3) * 0.05**2, (5, 1, 1))
    sound = register(points, points + random.normal(size=points.shape) * 0.05, covariance_mm2=covariance)
    assert sound.caveats == ()
    sound.require_sound()
    found = register(points, spoil(points), covariance_mm2=covariance)
    assert Caveat.MISFIT in found.caveats
    with raises(RESIDUAL_TOO_LARGE, match=r"REG-010.* at 99\.9%"):
        replace(found, caveats=(Caveat.MISFIT,)).require_sound()  # a swap of two may also look mirrored


def test_nearly_collinear_points_are_reported():
    points = np.array([[0, 0, 0], [50, 6, 0], [100, 0, 0], [150, 5, 0]], dtype=float)
    assert register(points, points).caveats == (Caveat.NEARLY_COLLINEAR,)


def test_the_transform_can_be_given_named_frames(random, fiducials):
    points = fiducials(4, random)
    named = register(points, points + 5.0).between(Frame.ROBOT, Frame.CT)
    assert (named.target, named.source) == (Frame.ROBOT, Frame.CT)
    assert np.allclose(named.apply(points), points + 5.0)


def test_register_neither_changes_its_inputs_nor_keeps_them(random, fiducials):
    points = fiducials(4, random)
    before, measured = points.copy(), points + 1.0
    found = register(points, measured)
    assert np.array_equal(points, before)
    assert np.array_equal(measured, before + 1.0)
    points[0] = 0.0
    assert np.array_equal(found.image_mm, before)


def test_a_gate_needs_a_known_error(random, fiducials):
    points = fiducials(4, random)
    with pytest.raises(BadParameter, match=r"REG-007.*Give fle_mm, or register with covariance_mm2"):
        register(points, points).gate()


EXAMPLE = Path(__file__).parents[3] / "examples" / "register_points.py"


def test_the_example_pairs_registers_and_predicts():
    done = subprocess.run(
        [sys.executable, "-P", EXAMPLE], capture_output=True, text=True, timeout=30, check=True
    )
    assert "correspondence: UNIQUE" in done.stdout
    assert done.stdout.count("is tracker reading") == 5
    fre, rms, limit, error = (float(value) for value in re.findall(r"(\d+\.\d+) mm", done.stdout))
    assert 0.0 < fre < 1.0
    assert 0.0 < rms < limit < 1.0
    assert error < limit
