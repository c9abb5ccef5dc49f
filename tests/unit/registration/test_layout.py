"""A layout is found among the spheres of a scan completely and unambiguously, or refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration import find_layout
from procedures.registration.errors import LayoutNotFound
from ronna_hw.x_frame import SPHERE_CENTRES_MM

FRAME_MM = np.array(SPHERE_CENTRES_MM)
OTHERS_MM = np.array([[80.0, 20.0, -40.0], [-70.0, 66.0, -20.0], [10.0, -90.0, -60.0]])


def scan_of(spheres_mm: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The spheres in any pose and order, with the scale error of a scanner; and where each of them went."""
    random = np.random.default_rng(seed)
    pose = RigidTransform.from_components(random.uniform(-300, 300, 3), Rotation.random(rng=random))
    seen = pose.apply(spheres_mm * random.uniform(0.999, 1.001)) + 0.02 * random.normal(size=spheres_mm.shape)
    order = random.permutation(len(seen))
    return seen[order], np.argsort(order)


@pytest.mark.parametrize("seed", range(20))
def test_the_frame_is_found_among_other_spheres_in_its_own_order(seed: int) -> None:
    spheres, where = scan_of(np.vstack([FRAME_MM, OTHERS_MM]), seed)
    found = find_layout(FRAME_MM, spheres)
    assert found.order.tolist() == where[:4].tolist()
    assert sorted(found.others) == sorted(where[4:].tolist())
    assert found.residual_rms_mm < 0.15


@pytest.mark.parametrize(
    "spheres_mm",
    [
        FRAME_MM[:3],  # one is missing
        FRAME_MM + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [1.5, 0, 0]]),  # one was bent
        np.vstack([FRAME_MM[:3], OTHERS_MM]),
        np.vstack([FRAME_MM, FRAME_MM + np.array([0.0, 0.0, 60.0])]),  # two frames
    ],
)
def test_a_scan_with_an_incomplete_frame_or_with_two_frames_is_refused(spheres_mm: np.ndarray) -> None:
    with pytest.raises(LayoutNotFound, match="REG-012"):
        find_layout(FRAME_MM, scan_of(spheres_mm, 1)[0])


def test_a_scan_of_too_many_spheres_is_refused_by_their_number() -> None:
    crowd = np.random.default_rng(1).uniform(-90.0, 90.0, (45, 3))
    with pytest.raises(LayoutNotFound, match=r"REG-012.*expected at most 40, got 45.*--pick"):
        find_layout(FRAME_MM, crowd)


def test_a_layout_in_another_unit_is_refused_with_both_widths() -> None:
    with pytest.raises(LayoutNotFound) as refused:
        find_layout(FRAME_MM / 10.0, scan_of(FRAME_MM, 1)[0])
    widest_mm = max(float(np.linalg.norm(a - b)) for a in FRAME_MM for b in FRAME_MM)
    assert f"up to {widest_mm / 10.0:.1f} mm apart" in refused.value.expected
    assert "the layout is in mm" in refused.value.advice
