"""Self-check of the head: is the ball at its calibrated position when viewed from the same eight poses?

Since calibration the ball may have been put down elsewhere (b, robot frame); the arm repeats to some
micrometres. A camera or mount that has moved shows up in the head's own frame. Three signs are checked:

- the shift d of the measured ball in the tool frame: measured - baseline = R^T b + d. Rotated and tilted
  poses separate d from b. A camera rotated by 0.01 deg in its mount causes 53 um.
- the change of the gap between the lines of sight: a rotation out of the stereo plane, whatever the arm does.
- the change of the ball's apparent size at its triangulated distance: a rotation within the stereo plane
  brings the ball nearer but does not make it larger. Independent of the arm as well.

The scale of each sign is the scatter of the views themselves, from both runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np
from pydantic import Field
from scipy.special import chdtri

from procedures.calibration.errors import CHECK_UNCERTAIN, HEAD_MOVED, NotTheBaseline
from procedures.calibration.head_model import cameras_of, intersect_rays
from procedures.calibration.observations import Observation
from ronna_hw.arrays import Array
from ronna_hw.calibration import StereoHeadCalibration, Strict
from ronna_hw.frames import Frame
from ronna_hw.text import format_against_limit, format_distinct
from ronna_hw.vectors import vector3

BASELINE_FILE = "baseline.json"
LEAST_ORIENTATIONS = 8
LEAST_VISITS = 2  # to each pose: the scatter between visits is the scale of all signs
FALSE_ALARM = 0.001  # per sign: at most three false alarms in a thousand checks of intact heads
TWIST_SHIFT_MM = 0.053  # effect of a camera rotated by 0.01 deg, which a check must be able to detect
SENSITIVITY = 3.0  # sigmas in the worst direction that this shift must amount to
SAME_POSE_RAD = np.radians(0.05)
# Common to all views of a run, so not in their scatter: illumination, focus, grain. Own estimates (U).
GAP_FLOOR_MM = 0.0005
SIZE_FLOOR = 4e-5  # relative: 0.01 px of a radius of 260 px
ARM_FLOOR_MM = 0.005


class Baseline(Strict):
    """Views of the eight orientations at calibration, and the record used to evaluate them."""

    schema_version: Literal[1] = Field(default=1, alias="schema")
    created: datetime
    stereo_head: StereoHeadCalibration
    arm_variant: str
    looks: tuple[Observation, ...]

    @property
    def orientations(self) -> tuple[int, ...]:
        """Numbers of the orientations, sorted."""
        return tuple(sorted({look.orientation for look in self.looks if look.orientation is not None}))

    @property
    def ball_mm(self) -> Array:
        """Ball position, (3,) in the robot frame, accurate to a tenth of a millimetre."""
        centres = [np.array([_centre(look, side) for look in self.looks]) for side in (0, 1)]
        points, _ = intersect_rays(cameras_of(self.stereo_head), *centres)
        in_robot = [look.flange_pose.apply(point) for look, point in zip(self.looks, points, strict=True)]
        return np.asarray(np.mean(in_robot, axis=0))

    def require_complete(self) -> None:
        """Raise CAL-008 unless every orientation was viewed often enough for comparison."""
        if (count := len(self.orientations)) < LEAST_ORIENTATIONS:
            raise NotTheBaseline(
                "the baseline has too few orientations", expected=str(LEAST_ORIENTATIONS), got=str(count)
            )
        _require_views(self.looks, self.orientations, "baseline")


@dataclass(frozen=True)
class Sign:
    """Sign that the head has changed: value, standard deviation, chi-square statistic and limit."""

    name: str
    unit: str
    value: tuple[float, ...]
    sigma: tuple[float, ...]
    statistic: float
    limit: float

    @property
    def sounds(self) -> bool:
        """Whether the statistic exceeds its limit."""
        return self.statistic > self.limit


@dataclass(frozen=True)
class CheckResult:
    """Result of a self-check: `shift` of the ball in the tool frame, `ball_moved_mm` in the robot frame.

    `repeatability_mm` is the scatter of the arm per axis in this run and in the baseline.
    """

    shift: Sign
    gap: Sign
    size: Sign
    ball_moved_mm: tuple[float, float, float]
    repeatability_mm: float
    looks: int

    @property
    def signs(self) -> tuple[Sign, ...]:
        """All three signs."""
        return self.shift, self.gap, self.size

    @property
    def passed(self) -> bool:
        """Whether all signs are within their limits."""
        return not any(sign.sounds for sign in self.signs)

    def require(self) -> None:
        """Raise CAL-006 listing the signs that exceed their limits."""
        bad = [sign for sign in self.signs if sign.sounds]
        if not bad:
            return
        moved = float(np.linalg.norm(self.shift.value))
        got, limit = format_distinct(bad[0].statistic, bad[0].limit, 1)
        raise HEAD_MOVED(
            "the stereo head has changed since its calibration "
            f"({', '.join(sign.name for sign in bad)}); the ball appears shifted by "
            f"{1000 * moved:.0f} um",
            limit=f"chi square {limit}",
            got=got,
        )


@dataclass(frozen=True)
class _RunMeans:
    """Means per orientation: ball in the tool frame (m, 3), gap (m,), size (m,), rotation, visits (m,)."""

    points_mm: Array
    gaps_mm: Array
    sizes: Array
    rotations: Array
    visits: Array
    arm_variance_mm2: float
    gap_variance_mm2: float
    size_variance: float
    freedom: int


def compare_with_baseline(looks: Sequence[Observation], baseline: Baseline) -> CheckResult:
    """Compare a check's views with the baseline. Raises CAL-008 for other poses, CAL-007 for scatter."""
    _require_same_poses(looks, baseline)
    head, numbers = baseline.stereo_head, baseline.orientations
    then, now = (_average_run(run, head, numbers) for run in (baseline.looks, looks))
    freedom = then.freedom + now.freedom
    arm = (then.arm_variance_mm2 * then.freedom + now.arm_variance_mm2 * now.freedom) / freedom
    arm = max(arm, ARM_FLOOR_MM**2)
    weights = 1.0 / (arm * (1.0 / then.visits + 1.0 / now.visits))
    still = np.tile(np.eye(3), (len(numbers), 1, 1))
    design = np.concatenate([now.rotations.transpose(0, 2, 1), still], axis=2)
    normal = np.einsum("n,nij,nik->jk", weights, design, design)
    covariance = np.linalg.inv(normal)
    solution = covariance @ np.einsum("n,nij,ni->j", weights, design, now.points_mm - then.points_mm)
    shift, shift_covariance = solution[3:], covariance[3:, 3:]
    worst = float(np.sqrt(np.linalg.eigvalsh(shift_covariance)[-1]))
    if SENSITIVITY * worst > TWIST_SHIFT_MM:
        raise CHECK_UNCERTAIN(
            "the check could not detect a camera rotated by 0.01 degrees",
            limit=f"{1000 * TWIST_SHIFT_MM / SENSITIVITY:.0f} um",
            got=f"{format_against_limit(1000 * worst, 1000 * TWIST_SHIFT_MM / SENSITIVITY, 0)} um",
        )
    share = float(np.sum(1.0 / then.visits + 1.0 / now.visits)) / len(numbers) ** 2
    gap_variance = 0.5 * (then.gap_variance_mm2 + now.gap_variance_mm2) * share + GAP_FLOOR_MM**2
    size_variance = 0.5 * (then.size_variance + now.size_variance) * share + SIZE_FLOOR**2
    return CheckResult(
        shift=Sign(
            "shift of the ball",
            "mm",
            tuple(shift.tolist()),
            tuple(np.sqrt(np.diag(shift_covariance)).tolist()),
            float(shift @ np.linalg.solve(shift_covariance, shift)),
            float(chdtri(3, FALSE_ALARM)),
        ),
        gap=_scalar_sign("gap of the lines of sight", "mm", now.gaps_mm - then.gaps_mm, gap_variance),
        size=_scalar_sign("size of the ball", "of its size", now.sizes - then.sizes, size_variance),
        ball_moved_mm=vector3(solution[:3]),
        repeatability_mm=float(np.sqrt(arm)),
        looks=len(looks),
    )


def _scalar_sign(name: str, unit: str, changes: Array, variance: float) -> Sign:
    value = float(np.mean(changes))
    sigma, limit = float(np.sqrt(variance)), float(chdtri(1, FALSE_ALARM))
    return Sign(name, unit, (value,), (sigma,), value * value / variance, limit)


def _require_same_poses(looks: Sequence[Observation], baseline: Baseline) -> None:
    baseline.require_complete()
    _require_views(looks, baseline.orientations, "check")
    poses = {look.orientation: np.array(look.joints_rad) for look in baseline.looks}
    for look in looks:
        if look.orientation is None or look.orientation not in poses:
            raise NotTheBaseline(f"the baseline has no orientation {look.orientation}")
        difference_rad = float(np.abs(np.array(look.joints_rad) - poses[look.orientation]).max())
        if difference_rad > SAME_POSE_RAD:
            raise NotTheBaseline(
                f"orientation {look.orientation + 1} was viewed from a different pose than in the baseline",
                limit=f"{np.degrees(SAME_POSE_RAD):.2f} deg in every joint",
                got=format_against_limit(math.degrees(difference_rad), math.degrees(SAME_POSE_RAD), 2)
                + " deg",
            )


def _require_views(looks: Sequence[Observation], orientations: Sequence[int], name: str) -> None:
    for number in orientations:
        count = sum(look.orientation == number for look in looks)
        if count < LEAST_VISITS:
            raise NotTheBaseline(
                f"the {name} has {count} view(s) from orientation {number + 1}",
                expected=f"at least {LEAST_VISITS}",
            )


def _average_run(
    run: Sequence[Observation], head: StereoHeadCalibration, numbers: Sequence[int]
) -> _RunMeans:
    cameras = cameras_of(head)
    tool = head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    centres = np.array([[_centre(look, side) for side in (0, 1)] for look in run])
    in_flange, gaps = intersect_rays(cameras, centres[:, 0], centres[:, 1])
    points = tool.inverse().apply(in_flange)
    sizes = np.zeros(len(run))
    for side, camera in enumerate(cameras):
        distance = np.linalg.norm(in_flange @ camera.rotation.T + camera.translation_mm, axis=1)
        minor = np.array([(look.left, look.right)[side].axes_px[1] for look in run])
        sizes += 0.5 * np.log(minor * distance)
    groups = [np.flatnonzero([look.orientation == number for look in run]) for number in numbers]
    visits = np.array([float(len(group)) for group in groups])
    freedom = int(visits.sum()) - len(groups)

    def scatter(values: Array) -> float:
        """Return the pooled variance between visits to the same pose, per axis."""
        columns = values.reshape(len(run), -1)
        total = sum(float(np.sum((columns[group] - columns[group].mean(axis=0)) ** 2)) for group in groups)
        return total / (freedom * columns.shape[1])

    rotations = np.array([(run[group[0]].flange_pose @ tool).rotation_matrix for group in groups])
    return _RunMeans(
        points_mm=np.array([points[group].mean(axis=0) for group in groups]),
        gaps_mm=np.array([gaps[group].mean() for group in groups]),
        sizes=np.array([sizes[group].mean() for group in groups]),
        rotations=rotations,
        visits=visits,
        arm_variance_mm2=scatter(points),
        gap_variance_mm2=scatter(gaps),
        size_variance=scatter(sizes),
        freedom=freedom,
    )


def _centre(look: Observation, side: int) -> tuple[float, float]:
    """Return the outline's centre; its perspective bias is the same in both runs and cancels."""
    return (look.left, look.right)[side].centre_px
