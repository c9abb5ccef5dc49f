"""Joint robot-world and hand-eye calibration, A X = Z B, with the covariance of X and Z.

A is the flange according to the arm, B the reference frame according to the tracker, X the frame on the
flange and Z the tracker in the room. The initial solution is linear: the rotations as the null vector of R_A
R_X - R_Z R_B = 0 with Kronecker products, then the translations (Shah 2013). From there least squares in all
twelve unknowns, rotations and positions each weighted by the scatter of the measurements themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import chdtri

from procedures.calibration.errors import FRAME_NOT_CARRIED, DoesNotFit
from procedures.calibration.pose_set import require_consistent, require_count, require_spread
from ronna_hw.arrays import Array, Mask
from ronna_hw.text import format_against_limit

LEAST_LOOKS = 15
TURNS_AGREE_RAD = float(np.radians(0.5))  # from one measurement to the next, of flange and frame
ROUNDS = 6  # of fit, scatter and outliers: they converge within four
FIRST_SCATTER_MM, FIRST_SCATTER_RAD = 0.2, 5e-4
LEAST_SCATTER_MM, LEAST_SCATTER_RAD = 0.003, 1e-5  # no arm and no tracker is better
LARGEST_SCATTER_MM = 0.6  # per axis: uncalibrated arms show up to 0.3
LARGEST_SCATTER_RAD = float(np.radians(0.15))  # per axis: uncalibrated arms show up to 0.04 degrees
OUTLIER_CHI2 = float(chdtri(6, 0.001))
MOST_OUTLIERS = 0.1
STEP = 1e-6  # of a numerical derivative, mm or rad
UNKNOWNS = 12  # X, then Z: rotation vector (rad) in the source's own axes, and translation (mm)


@dataclass(frozen=True)
class HandEye:
    """Solution `flange_from_marker` and `robot_from_tracker` (4, 4), with their covariance (12, 12).

    The scatters are per axis; `misses_mm` and `misses_rad` (m, 3) are in the robot frame; `used` (m,) marks
    the inliers.
    """

    flange_from_marker: Array
    robot_from_tracker: Array
    covariance: Array
    scatter_mm: float
    scatter_rad: float
    misses_mm: Array
    misses_rad: Array
    used: Mask

    @property
    def error_mm(self) -> float:
        """3-D standard error of the frame's origin on the flange."""
        return float(np.sqrt(np.trace(self.covariance[3:6, 3:6])))

    @property
    def error_rad(self) -> float:
        """Standard error of the frame's orientation, as the length of a rotation vector."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))


def solve(
    pairs: PosePairs,
    *,
    least_looks: int = LEAST_LOOKS,
    largest_scatter_mm: float = LARGEST_SCATTER_MM,
    largest_scatter_rad: float = LARGEST_SCATTER_RAD,
) -> HandEye:
    """Solve for the frame's pose on the flange from pose pairs.

    The largest scatters, per axis, are what errors of the arm explain. Raises CAL-002 to CAL-004, CAL-015.
    """
    _require_solvable(pairs, least_looks)
    x, z = _solve_linear(pairs)
    scatter = np.array([FIRST_SCATTER_MM] * 3 + [FIRST_SCATTER_RAD] * 3)
    used = np.ones(pairs.count, dtype=bool)
    for _ in range(ROUNDS):
        misses, slopes = misses_of(pairs, x, z), slopes_of(pairs, x, z)
        rows = (slopes[used] / scatter[:, None]).reshape(-1, UNKNOWNS)
        covariance = np.linalg.inv(rows.T @ rows)
        change = -covariance @ rows.T @ (misses[used] / scatter).ravel()
        x, z = apply_change(x, change[:6]), apply_change(z, change[6:])
        misses = misses_of(pairs, x, z)
        freedom = 3 * int(used.sum()) - UNKNOWNS // 2  # of positions; rotations have as many
        squares = np.sum(misses[used] ** 2, axis=0)
        scatter_mm = max(float(np.sqrt(squares[:3].sum() / freedom)), LEAST_SCATTER_MM)
        scatter_rad = max(float(np.sqrt(squares[3:].sum() / freedom)), LEAST_SCATTER_RAD)
        scatter = np.array([scatter_mm] * 3 + [scatter_rad] * 3)
        used = np.sum((misses / scatter) ** 2, axis=1) < OUTLIER_CHI2
    _require_fit((scatter_mm, scatter_rad), (largest_scatter_mm, largest_scatter_rad), used)
    return HandEye(x, z, covariance, scatter_mm, scatter_rad, misses[:, :3], misses[:, 3:], used)


def misses_of(pairs: PosePairs, x: Array, z: Array) -> Array:
    """Return how A X differs from Z B, (m, 6): position (mm) and rotation vector (rad), robot frame."""
    by_arm, by_tracker = pairs.robot_from_flange @ x, z @ pairs.tracker_from_marker
    apart = by_arm[:, :3, :3] @ by_tracker[:, :3, :3].transpose(0, 2, 1)
    turned = Rotation.from_matrix(apart).as_rotvec()
    return np.hstack([by_arm[:, :3, 3] - by_tracker[:, :3, 3], turned])


def slopes_of(pairs: PosePairs, x: Array, z: Array) -> Array:
    """Return the derivative (m, 6, 12) of the misses with respect to the parameters."""
    slopes = np.empty((pairs.count, 6, UNKNOWNS))
    still_x, still_z = (apply_change(pose, np.zeros(6)) for pose in (x, z))  # rounded as the others are
    for column, step in enumerate(STEP * np.eye(6)):
        ahead, behind = (misses_of(pairs, apply_change(x, way), still_z) for way in (step, -step))
        slopes[:, :, column] = (ahead - behind) / (2.0 * STEP)
        ahead, behind = (misses_of(pairs, still_x, apply_change(z, way)) for way in (step, -step))
        slopes[:, :, 6 + column] = (ahead - behind) / (2.0 * STEP)
    return slopes


def _require_solvable(pairs: PosePairs, least_looks: int) -> None:
    action = "Clear the line of sight between tracker and frame, then calibrate again."
    require_count(pairs.count, least_looks, "too few poses show the reference frame", action)
    flange, marker = pairs.robot_from_flange[:, :3, :3], pairs.tracker_from_marker[:, :3, :3]
    apart = np.abs(_successive_angles_rad(flange) - _successive_angles_rad(marker))
    if np.median(apart) > TURNS_AGREE_RAD:
        raise FRAME_NOT_CARRIED(
            "the tool tracked as the reference frame does not rotate with the flange",
            limit=f"{np.degrees(TURNS_AGREE_RAD):g} deg from pose to pose",
            got=format_against_limit(math.degrees(np.median(apart)), math.degrees(TURNS_AGREE_RAD), 1)
            + " deg",
        )
    action = "Have the arm rotate the frame about axes in all directions, by at least 20 degrees."
    require_spread(flange, "the poses rotate the frame about nearly parallel axes, or hardly at all", action)


def _require_fit(scatter: tuple[float, float], largest: tuple[float, float], used: Mask) -> None:
    """Require scatters in mm and rad within the largest ones."""
    if scatter[0] > largest[0] or scatter[1] > largest[1]:
        scatter_deg, largest_deg = np.degrees(scatter[1]), np.degrees(largest[1])
        raise DoesNotFit(
            "no pose of the frame on the flange explains the data of arm and tracker",
            limit=f"{largest[0]:g} mm and {largest_deg:.2f} deg per axis",
            got=f"{format_against_limit(scatter[0], largest[0], 2)} mm and "
            f"{format_against_limit(scatter_deg, largest_deg, 2)} deg",
            action="Check that the frame, the mount and the tracker's stand are rigid and the "
            "arm variant is right.",
        )
    require_consistent(used, MOST_OUTLIERS, "poses")


def _successive_angles_rad(rotations: Array) -> Array:
    """Return the angle (m - 1,) from each rotation to the next, in rad."""
    between = rotations[:-1].transpose(0, 2, 1) @ rotations[1:]
    return np.asarray(Rotation.from_matrix(between).magnitude())


def _solve_linear(pairs: PosePairs) -> tuple[Array, Array]:
    a, b = pairs.robot_from_flange, pairs.tracker_from_marker
    unit = np.eye(3)
    equations = [
        np.hstack([np.kron(one[:3, :3], unit), -np.kron(unit, other[:3, :3].T)])
        for one, other in zip(a, b, strict=True)
    ]
    null = np.linalg.svd(np.vstack(equations))[2][-1]
    x, z = np.eye(4), np.eye(4)
    x[:3, :3], z[:3, :3] = (_rotation_along(half.reshape(3, 3)) for half in (null[:9], null[9:]))
    design = np.concatenate([a[:, :3, :3], np.tile(-unit, (pairs.count, 1, 1))], axis=2).reshape(-1, 6)
    offsets = (np.einsum("ij,mj->mi", z[:3, :3], b[:, :3, 3]) - a[:, :3, 3]).ravel()
    solution = np.linalg.lstsq(design, offsets, rcond=None)[0]
    x[:3, 3], z[:3, 3] = solution[:3], solution[3:]
    return x, z


def _rotation_along(matrix: Array) -> Array:
    """Return the rotation nearest to a matrix of unknown sign and scale, such as a null vector."""
    return np.asarray(Rotation.from_matrix(np.sign(np.linalg.det(matrix)) * matrix).as_matrix())


def apply_change(pose: Array, change: Array) -> Array:
    """Rotate a pose about the axes of its source frame and translate it along those of its target frame."""
    here = RigidTransform.from_matrix(pose)
    turned = here.rotation * Rotation.from_rotvec(change[:3])
    return np.asarray(RigidTransform.from_components(here.translation + change[3:], turned).as_matrix())


@dataclass(frozen=True)
class PosePairs:
    """Pose pairs as matrices (m, 4, 4): ROBOT <- FLANGE from the arm, TRACKER <- MARKER from the tracker."""

    robot_from_flange: Array
    tracker_from_marker: Array

    @property
    def count(self) -> int:
        """Number of poses."""
        return len(self.robot_from_flange)
