"""Bundle adjustment combined with hand-eye calibration: ball, camera poses on the flange, and lenses.

The arm is by far the least accurate instrument: it positions the ball with errors of 0.02 to 0.2 mm, while an
outline is accurate to micrometres. Every view therefore has an unknown shift of the ball, with a common
standard deviation estimated from the views themselves. The shift is not estimated but marginalised, which
leaves four pixel residuals per view with the covariance

    C = S + s^2 J J^T        S: of both outlines, J: pixels by ball position, s: error of the arm per axis

An error of the arm beyond its repeatability is due to its geometry, equal in all views. The errors of its
links and joints are then estimated along with the head, with the prior sizes of uncalibrated arms. Ignored,
they would be mistaken for an offset of the tool centre.

The ball's diameter is not needed: the arm provides the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from procedures.calibration.errors import DoesNotFit
from procedures.calibration.head_model import (
    CAMERA_PARAMETERS,
    Cameras,
    adjust_cameras,
    cameras_of,
    intersect_rays,
)
from procedures.calibration.observations import Observation
from procedures.calibration.pose_set import require_consistent, require_count, require_scatter, require_spread
from ronna_hw.arm.kinematics import Chain
from ronna_hw.arrays import Array, Mask
from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED_MM, error_columns
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.robust_scale import robust_sigma
from ronna_hw.text import format_against_limit

LEAST_POSES = 60
BALL = 3
HEAD = BALL + 2 * CAMERA_PARAMETERS
# Prior of head and lenses about their record, one standard deviation. A good arm overrides it; it constrains
# what a small field hardly reveals, and orientation errors that a bad arm would cause.
TURN_SIGMA_RAD = 0.0035  # 0.2 degrees: a machined mount
LENS_SIGMA = (0.01, 10.0, 10.0, 0.05)  # focal length (relative), principal point (px), k1
PRIOR_COLUMNS = (0, 1, 2, 6, 7, 8, 9)  # of a camera's parameters: rotation and lens
ROUNDS = 6  # of re-estimating the arm's error, which converges in four
STEPS = 20  # per round; the next round continues from there
FIRST_ARM_ERROR_MM = 2.0  # while the tool frame is still the nominal one
REPEATABILITY_MM = 0.03  # KR 6 R900, ISO 9283; anything beyond is systematic and does not average out
LEAST_ARM_ERROR_MM = 0.003  # no arm is better
ARM_ERROR_LIMIT_MM = 1.0  # far above an uncalibrated arm: something else is wrong
GAP_LIMIT_PX = 2.0  # inconsistency within one pair of outlines
DERIVATIVE_STEP = 1e-6  # rad, mm or px: all parameters are of the order of one
HUBER = 2.0  # sigmas
OUTLIER_CHI2 = 18.5  # exceeded by 0.1 % of good views, with four degrees of freedom
MOST_OUTLIERS = 0.2


@dataclass(frozen=True)
class BundleFit:
    """Adjusted head. Covariance (23, 23) of the ball (3, mm) and ten parameters per camera.

    `arm_error_mm` is the estimated error of the arm per axis including its geometry; `arm_scatter_mm` its
    random part from view to view; `image_sigma_px` the error of an outline's centre; `residuals_px` (n, 4)
    left x y, right x y, including the arm's contribution; `shifts_mm` (n, 3) that contribution in the robot
    frame; `used` (n,) marks the inliers.
    """

    cameras: Cameras
    ball_mm: Array
    covariance: Array
    arm_error_mm: float
    arm_scatter_mm: float
    image_sigma_px: float
    residuals_px: Array
    shifts_mm: Array
    used: Mask


@dataclass(frozen=True)
class _Looks:
    """Observations as arrays, and what the cameras should see by the parameters."""

    start: Cameras
    rotations: Array  # (n, 3, 3) robot <- flange
    translations_mm: Array  # (n, 3)
    centres_px: Array  # (n, 2 cameras, 2)
    semi_minors_px: Array  # (n, 2)
    covariances_px2: Array  # (n, 4, 4)
    arm_columns_mm: Array  # (n, 3, k) effects of the k geometric errors of the arm; k = 0: none estimated

    @classmethod
    def of(cls, observations: Sequence[Observation], start: Cameras) -> Self:
        poses = [observation.flange_pose for observation in observations]
        covariances = np.zeros((len(observations), 4, 4))
        for number, one in enumerate(observations):
            covariances[number, :2, :2] = one.left.covariance_px2
            covariances[number, 2:, 2:] = one.right.covariance_px2
        return cls(
            start,
            np.array([pose.rotation_matrix for pose in poses]),
            np.array([pose.translation_mm for pose in poses]),
            np.array([[one.left.centre_px, one.right.centre_px] for one in observations]),
            np.array([[one.left.axes_px[1], one.right.axes_px[1]] for one in observations]),
            covariances,
            np.zeros((len(observations), 3, 0)),
        )

    def cameras(self, values: Array) -> Cameras:
        return adjust_cameras(self.start, values[BALL:HEAD])

    def _flange_points(self, values: Array) -> Array:
        from_flange = values[:BALL] - self.translations_mm - self.arm_columns_mm @ values[HEAD:]
        return np.asarray(np.einsum("nji,nj->ni", self.rotations, from_flange))

    def residuals(self, values: Array) -> Array:
        points = self._flange_points(values)
        left, right = (
            self.centres_px[:, side] - camera.image_points(points, self.semi_minors_px[:, side])
            for side, camera in enumerate(self.cameras(values))
        )
        return np.hstack([left, right])

    def ball_slopes(self, values: Array) -> Array:
        """Return the derivative (n, 4, 3) of the pixels with respect to the ball position, robot frame."""
        points = self._flange_points(values)
        slopes = np.concatenate([camera.slopes(points) for camera in self.cameras(values)], axis=1)
        return np.asarray(np.einsum("nij,nkj->nik", slopes, self.rotations))

    def whitening(self, values: Array, arm_error: float, image_scale: float) -> Array:
        """Return matrices (n, 4, 4) that whiten the residuals of each view."""
        slopes = self.ball_slopes(values)
        total = image_scale**2 * self.covariances_px2 + arm_error**2 * slopes @ slopes.transpose(0, 2, 1)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(total)))


def fit_bundle(
    observations: Sequence[Observation], start: StereoHeadCalibration, *, arm: Chain | None = None
) -> BundleFit:
    """Adjust the head to the observations, starting within a few millimetres and degrees.

    With `arm`, its geometric errors are estimated when its error exceeds its repeatability. Raises CAL-002
    with too few views, CAL-003 when their orientations do not vary enough, CAL-004 when nothing fits.
    """
    require_count(len(observations), LEAST_POSES, "too few poses show the ball")
    looks = _Looks.of(observations, cameras_of(start))
    require_spread(looks.rotations, "the orientations of the poses hardly vary")
    points, _ = intersect_rays(looks.start, looks.centres_px[:, 0], looks.centres_px[:, 1])
    in_robot = np.einsum("nij,nj->ni", looks.rotations, points) + looks.translations_mm
    values = np.zeros(HEAD)
    values[:BALL] = np.median(in_robot, axis=0)
    estimate = _adjust(looks, values, FIRST_ARM_ERROR_MM)
    arm_error = estimate.arm_error
    require_scatter(arm_error, ARM_ERROR_LIMIT_MM, "the ball seems to move between measurements")
    if arm is not None and arm_error > REPEATABILITY_MM:
        columns = error_columns(arm, [one.joints_rad for one in observations], estimate.values[:BALL])
        looks = replace(looks, arm_columns_mm=columns * min(1.0, arm_error / UNCALIBRATED_MM))
        values = np.concatenate([estimate.values, np.zeros(columns.shape[2])])
        estimate = _adjust(looks, values, arm_error)
    _require_fit(estimate.used, estimate.gaps, looks)
    values = estimate.values
    whitening = looks.whitening(values, estimate.arm_error, estimate.image_scale)
    slopes = _Cost(looks, whitening, estimate.used).slopes(values)  # without robust weights
    outline_px = float(np.sqrt(np.mean(np.einsum("nii->ni", looks.covariances_px2))))
    return BundleFit(
        cameras=looks.cameras(values),
        ball_mm=values[:BALL].copy(),
        covariance=np.asarray(np.linalg.inv(slopes.T @ slopes)[:HEAD, :HEAD], dtype=float),
        arm_error_mm=arm_error,
        arm_scatter_mm=estimate.arm_error,
        image_sigma_px=estimate.image_scale * outline_px,
        residuals_px=estimate.residuals,
        shifts_mm=estimate.shifts,
        used=estimate.used,
    )


@dataclass(frozen=True)
class _Estimate:
    values: Array
    arm_error: float
    image_scale: float
    residuals: Array
    shifts: Array
    gaps: Array
    used: Mask


def _adjust(looks: _Looks, values: Array, arm_error: float) -> _Estimate:
    """Alternate between adjusting all values and estimating the error sizes, excluding outlying views."""
    from scipy.optimize import least_squares  # imported late: a case measures with a calibrated head

    image_scale = 1.0
    used = np.ones(len(looks.rotations), dtype=bool)
    residuals = shifts = gaps = np.empty(0)
    for _ in range(ROUNDS):
        cost = _Cost(looks, looks.whitening(values, arm_error, image_scale), used)
        options = {"x_scale": "jac", "loss": "huber", "f_scale": HUBER, "max_nfev": STEPS}
        values = least_squares(cost, values, jac=cost.slopes, **options).x
        residuals = looks.residuals(values)
        shifts, gaps = _split_residuals(looks, values, residuals, arm_error, image_scale)
        arm_error, image_scale = _error_sizes(shifts, gaps, used)
        whitening = looks.whitening(values, arm_error, image_scale)
        whitened = np.einsum("nij,nj->ni", whitening, residuals)
        used = np.sum(whitened**2, axis=1) < OUTLIER_CHI2
    return _Estimate(values, arm_error, image_scale, residuals, shifts, gaps, used)


class _Cost:
    """Cost vector: whitened residuals of the views in use, and priors for cameras and arm."""

    def __init__(self, looks: _Looks, whitening: Array, used: Mask) -> None:
        self._looks, self._whitening, self._used = looks, whitening, used

    def __call__(self, values: Array) -> Array:
        residuals = self._looks.residuals(values)[self._used]
        whitened = np.einsum("nij,nj->ni", self._whitening[self._used], residuals)
        return np.concatenate([whitened.ravel(), _prior(values)])

    def slopes(self, values: Array) -> Array:
        """Return the Jacobian (m, 23 + k): finite differences for the head, exact for the arm's k errors."""
        here = self(values)
        slopes = np.zeros((len(here), len(values)))
        for column in range(HEAD):
            step = np.zeros(len(values))
            step[column] = DERIVATIVE_STEP
            slopes[:, column] = (self(values + step) - here) / DERIVATIVE_STEP
        errors = len(values) - HEAD
        if errors:
            by_errors = self._looks.ball_slopes(values) @ self._looks.arm_columns_mm
            whitened = (self._whitening @ by_errors)[self._used]
            slopes[: -len(_prior(values)), HEAD:] = whitened.reshape(-1, errors)
            slopes[-errors:, HEAD:] = np.eye(errors)
        return slopes


def _prior(values: Array) -> Array:
    sigmas = np.array([*3 * (TURN_SIGMA_RAD,), *LENS_SIGMA])
    cameras = values[BALL:HEAD].reshape(2, CAMERA_PARAMETERS)
    return np.concatenate([(cameras[:, PRIOR_COLUMNS] / sigmas).ravel(), values[HEAD:]])


def _split_residuals(
    looks: _Looks, values: Array, residuals: Array, arm_error: float, image_scale: float
) -> tuple[Array, Array]:
    """Split residuals into shifts of the arm (n, 3) mm and the part that no shift explains (n,), in sigmas.

    Four pixel coordinates and three unknowns leave one contradiction per view: the gap between the two rays.
    """
    slopes = looks.ball_slopes(values)
    weights = np.linalg.inv(image_scale**2 * looks.covariances_px2)
    normal = slopes.transpose(0, 2, 1) @ weights @ slopes + np.eye(3) / arm_error**2
    pull = slopes.transpose(0, 2, 1) @ weights @ residuals[:, :, None]
    shifts = np.asarray(np.linalg.solve(normal, pull)[:, :, 0], dtype=float)
    # The direction in pixel space that no shift affects: the left null vector of the derivative.
    null = np.linalg.svd(slopes)[0][:, :, 3]
    sigma = np.sqrt(np.einsum("ni,nij,nj->n", null, looks.covariances_px2, null))
    return shifts, np.einsum("ni,ni->n", null, residuals) / sigma


def _error_sizes(shifts: Array, gaps: Array, used: Mask) -> tuple[float, float]:
    """Estimate robustly the arm's error per axis in mm, and the image error relative to its covariance."""
    count = int(used.sum())
    freedom = np.sqrt(max(0.3, 1.0 - HEAD / (4.0 * count)))
    arm = robust_sigma(shifts[used]) / freedom
    image = robust_sigma(gaps[used]) / freedom
    return max(arm, LEAST_ARM_ERROR_MM), max(image, 1.0)


def _require_fit(used: Mask, gaps: Array, looks: _Looks) -> None:
    gap_px = float(np.median(np.abs(gaps))) * float(np.sqrt(looks.covariances_px2[:, 0, 0].mean()))
    if gap_px > GAP_LIMIT_PX:
        raise DoesNotFit(
            "left and right images contradict each other",
            limit=f"{GAP_LIMIT_PX:g} px",
            got=f"{format_against_limit(gap_px, GAP_LIMIT_PX, 1)} px",
        )
    require_consistent(used, MOST_OUTLIERS, "looks")
