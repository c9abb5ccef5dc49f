"""Base of the assistant in the base of the master, from two kinds of measurement.

The tracker sees the frames of both arms, brought to the same region one after the other. Each arm's own
solution of A X = Z B is the tracker in its base, and both together are the bases; the tracker's smooth error
in that region shifts both alike. Then the master's stereo head looks at a ball that the assistant holds, in
many postures of both. Least squares yield the bases, the ball on its flange, and the errors that both arms
keep, each known to the size that its record states. Bases and errors belong together: they predict how far
two tools are apart in other postures of the region. Both arms must have been calibrated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtri

from procedures.calibration.arm_errors import FoundArm, StatedArm
from procedures.calibration.errors import BASES_DISAGREE, DegeneratePoses
from procedures.calibration.hand_eye import PosePairs, apply_change, solve
from procedures.calibration.pose_set import require_consistent, require_count, require_scatter, require_spread
from procedures.strategies.strategy import ONE_SIDE
from ronna_hw.arrays import Array, Mask
from ronna_hw.text import format_against_limit

LEAST_FRAME_LOOKS = 8  # 20 leave the bases no better: the tracker is a smooth 0.25 mm off in the region
LEAST_BALL_LOOKS = 12
ROUNDS = 8  # of fit, scatter and outliers: they converge within five
LEAST_SCATTER_MM = 0.02  # no pair of arms comes back better
LARGEST_SCATTER_MM = 0.3  # per axis: two calibrated arms show 0.03, uncalibrated ones 0.5
OUTLIER_CHI2 = float(chdtri(3, 0.001))
MOST_OUTLIERS = 0.1
LARGEST_ERROR_MM = 0.1  # standard, of where both tools meet
LARGEST_ERROR_RAD = float(np.radians(0.1))  # standard, of the bases: beyond, the postures differ too little
# The smooth error of the tracker is not equal for both frames: per axis, what remains of its stated 0.25 mm.
REGION_BIAS_MM = 0.08
AGREE_CHI2 = float(chdtri(3, 0.001))
BASES, BALL = slice(0, 6), slice(6, 9)  # of the unknowns; errors of master and assistant follow


@dataclass(frozen=True)
class BaseToBase:
    """Pose ROBOT <- base of the assistant (4, 4) and its covariance (6, 6).

    The covariance is that of a rotation vector about the axes of the assistant's base (rad) and of a shift
    along those of the robot frame (mm).
    """

    robot_from_base: Array
    covariance: Array

    def covariance_at(self, place_mm: ArrayLike) -> Array:
        """Return the covariance (3, 3) in mm2 of a place of the assistant, (3,) mm in the robot frame."""
        slope = _place_slope(self.robot_from_base, place_mm)
        return np.asarray(slope @ self.covariance @ slope.T)

    def error_mm(self, place_mm: ArrayLike) -> float:
        """Return the 3-D standard error at a place of the robot frame, (3,) mm."""
        return float(np.sqrt(np.trace(self.covariance_at(place_mm))))


class BasesByFrames(NamedTuple):
    """Bases by the tracker, with poses (4, 4) of the tracker and of both frames on their flanges."""

    bases: BaseToBase
    robot_from_tracker: Array
    flange_from_master_frame: Array
    flange_from_frame: Array  # of the assistant


def bases_by_frames(
    master: PosePairs, assistant: PosePairs, arms_error_mm: tuple[float, float]
) -> BasesByFrames:
    """Combine what the tracker saw of both frames. Raises CAL-002 to CAL-004, CAL-015.

    `arms_error_mm` are the stated 3-D errors of both arms' records: errors of the last links cannot be told
    from those of the frames.
    """
    first, second = (solve(one, least_looks=LEAST_FRAME_LOOKS) for one in (master, assistant))
    z_master, z_assistant = first.robot_from_tracker, second.robot_from_tracker
    bases = z_master @ np.linalg.inv(z_assistant)
    # The change of a pose is as in `hand_eye`: rotation in the source, here the tracker, shift in the target.
    turn, about = bases[:3, :3], _cross_matrix(z_assistant[:3, 3])
    slope = np.zeros((6, 12))
    slope[:3, :3], slope[:3, 6:9] = z_assistant[:3, :3], -z_assistant[:3, :3]
    slope[3:, 3:6], slope[3:, 9:12] = np.eye(3), -turn
    slope[3:] += turn @ about @ slope[:3]
    both = np.zeros((12, 12))
    both[:6, :6], both[6:, 6:] = first.covariance[6:, 6:], second.covariance[6:, 6:]
    covariance = slope @ both @ slope.T
    covariance[3:, 3:] += np.eye(3) * (REGION_BIAS_MM**2 + sum(error**2 for error in arms_error_mm) / 3.0)
    return BasesByFrames(
        BaseToBase(bases, covariance), z_master, first.flange_from_marker, second.flange_from_marker
    )


@dataclass(frozen=True)
class BallLooks:
    """Ball of the assistant, seen by the master's stereo head in m pairs of postures.

    Poses (m, 4, 4) by the models of both arms: ROBOT <- TOOL of the head, and base of the assistant <- its
    flange. `ball_mm` (m, 3) is the ball in the tool frame of the head; joints (m, axes), each having arrived
    from `ONE_SIDE`.
    """

    robot_from_head: Array
    ball_mm: Array
    base_from_flange: Array
    master_rad: Array
    assistant_rad: Array

    @property
    def count(self) -> int:
        """Number of looks."""
        return len(self.ball_mm)

    @property
    def region_mm(self) -> Array:
        """Middle of the places where the ball was seen, (3,) in the robot frame."""
        return np.asarray(_apply(self.robot_from_head, self.ball_mm).mean(axis=0))


@dataclass(frozen=True)
class BallFit:
    """Bases refined by the ball, with the errors of both arms, and how well all looks agree.

    `error_mm` is the 3-D standard error with which the head is predicted to meet the ball, averaged over
    postures like those of the looks, each predicted by the others; once, the scatter comes on top
    (`meeting_mm`). `misses_mm` (m, 3) are in the robot frame; `used` (m,) marks the inliers.
    """

    bases: BaseToBase
    master: FoundArm
    assistant: FoundArm
    flange_from_ball_mm: Array
    scatter_mm: float
    misses_mm: Array
    used: Mask
    region_mm: Array
    error_mm: float

    @property
    def meeting_mm(self) -> float:
        """3-D standard error with which both tools meet once, in a new posture like those of the looks."""
        return meeting_error_mm(self.error_mm, self.scatter_mm)


def meeting_error_mm(error_mm: float, scatter_mm: float) -> float:
    """Return the error of one meeting: that of the fit (3-D), and the scatter of the looks (per axis)."""
    return float(np.hypot(error_mm, np.sqrt(3.0) * scatter_mm))


def refine_bases(
    coarse: BaseToBase,
    looks: BallLooks,
    ball_on_flange_mm: ArrayLike,
    ball_error_mm: float,
    master: StatedArm,
    assistant: StatedArm,
) -> BallFit:
    """Refine the bases by the looks at the ball. Raises CAL-002 to CAL-004, CAL-022.

    `ball_on_flange_mm` (3,) is where the ball is by its record, with `ball_error_mm` per axis.
    """
    require_count(looks.count, LEAST_BALL_LOOKS, "too few looks at the ball of the assistant")
    require_spread(
        looks.base_from_flange[:, :3, :3],
        "the assistant turns the ball about nearly parallel axes, or hardly at all",
        "Have the assistant turn the ball about axes in all directions, by at least 20 degrees.",
    )
    bases, recorded_mm = coarse.robot_from_base, np.asarray(ball_on_flange_mm, dtype=float)
    seen_mm = _apply(looks.robot_from_head, looks.ball_mm)
    by_master = master.displacements(looks.master_rad, seen_mm, ONE_SIDE)
    held_mm = _apply(looks.base_from_flange, np.tile(recorded_mm, (looks.count, 1)))
    by_assistant = assistant.displacements(looks.assistant_rad, held_mm, ONE_SIDE)
    of_master = slice(BALL.stop, BALL.stop + by_master.shape[2])
    of_assistant = slice(of_master.stop, of_master.stop + by_assistant.shape[2])
    found = np.zeros(of_assistant.stop)  # ball beside its record, and errors; the bases are changed as poses
    prior = np.ones_like(found)
    prior[BASES], prior[BALL] = 0.0, ball_error_mm**-2
    used, scatter_mm = np.ones(looks.count, dtype=bool), LARGEST_SCATTER_MM
    for _ in range(ROUNDS):
        slopes = np.concatenate(
            [_ball_slopes(looks, bases, recorded_mm + found[BALL]), by_master, -bases[:3, :3] @ by_assistant],
            axis=2,
        )
        misses = _ball_misses(looks, bases, recorded_mm) + slopes[:, :, BALL.start :] @ found[BALL.start :]
        rows = slopes[used].reshape(-1, len(found)) / scatter_mm
        information = rows.T @ rows
        covariance = np.linalg.inv(information + np.diag(prior))
        change = covariance @ (-rows.T @ (misses[used].ravel() / scatter_mm) - prior * found)
        bases, found = apply_change(bases, change[BASES]), found + change
        found[BASES] = 0.0
        misses = misses + slopes @ change
        weighed_mm, freedom = scatter_mm, 3 * int(used.sum()) - float(np.vdot(information, covariance))
        scatter_mm = max(float(np.sqrt(np.sum(misses[used] ** 2) / freedom)), LEAST_SCATTER_MM)
        used = np.sum(misses**2, axis=1) < OUTLIER_CHI2 * scatter_mm**2
    require_scatter(
        scatter_mm,
        LARGEST_SCATTER_MM,
        "no pose of the assistant's base explains the looks at its ball",
        "Check that ball, stereo head and both carts are rigid and both arms calibrated.",
    )
    require_consistent(used, MOST_OUTLIERS, "looks at the ball")
    fit = BallFit(
        bases=BaseToBase(bases, np.asarray(covariance[BASES, BASES], dtype=np.float64)),
        master=FoundArm(master, tuple(found[of_master].tolist())),
        assistant=FoundArm(assistant, tuple(found[of_assistant].tolist())),
        flange_from_ball_mm=recorded_mm + found[BALL],
        scatter_mm=scatter_mm,
        misses_mm=misses,
        used=used,
        region_mm=looks.region_mm,
        error_mm=_predicted_error_mm(slopes[used], covariance, weighed_mm),
    )
    turned_rad = float(np.sqrt(np.trace(covariance[:3, :3])))
    if fit.error_mm > LARGEST_ERROR_MM or turned_rad > LARGEST_ERROR_RAD:
        turned_deg, largest_deg = np.degrees(turned_rad), np.degrees(LARGEST_ERROR_RAD)
        raise DegeneratePoses(
            "the looks at the ball leave the bases too uncertain",
            limit=f"{LARGEST_ERROR_MM:g} mm, {largest_deg:g} deg",
            got=f"{format_against_limit(fit.error_mm, LARGEST_ERROR_MM, 2)} mm, "
            f"{format_against_limit(turned_deg, largest_deg, 2)} deg",
            action="Have the assistant hold the ball in more postures, farther apart.",
        )
    require_agreement(coarse, fit)
    return fit


def _predicted_error_mm(slopes: Array, covariance: Array, scatter_mm: float) -> float:
    """Return the 3-D standard error of each look as predicted by the others, averaged.

    Without a look, the covariance of its misses, H by all in units of the scatter, grows to H / (1 - H).
    """
    by_all = np.einsum("mai,ij,mbj->mab", slopes, covariance, slopes) / scatter_mm**2
    by_others = by_all @ np.linalg.inv(np.eye(3) - by_all)
    return scatter_mm * float(np.sqrt(np.einsum("maa->m", by_others).mean()))


def require_agreement(coarse: BaseToBase, fit: BallFit) -> None:
    """Raise CAL-022 if the tracker and the ball disagree about the bases by more than both allow."""
    there_mm = RigidTransform.from_matrix(fit.bases.robot_from_base).inv().apply(fit.region_mm)
    apart = _apply(coarse.robot_from_base, there_mm) - fit.region_mm
    covariance = coarse.covariance_at(fit.region_mm) + fit.bases.covariance_at(fit.region_mm)
    squared = float(apart @ np.linalg.solve(covariance, apart))
    if squared > AGREE_CHI2:
        limit_mm = float(np.linalg.norm(apart)) * float(np.sqrt(AGREE_CHI2 / squared))
        raise BASES_DISAGREE(
            "tracker and stereo head disagree about where the assistant stands",
            limit=f"{limit_mm:.2f} mm",
            got=f"{format_against_limit(float(np.linalg.norm(apart)), limit_mm, 2)} mm",
        )


def _ball_misses(looks: BallLooks, bases: Array, ball: Array) -> Array:
    """Return the ball by the master minus the ball by the assistant, (m, 3) mm in the robot frame."""
    held = _apply(looks.base_from_flange, np.tile(ball, (looks.count, 1)))
    return np.asarray(_apply(looks.robot_from_head, looks.ball_mm) - _apply(bases, held))


def _ball_slopes(looks: BallLooks, bases: Array, ball: Array) -> Array:
    """Return the derivative (m, 3, 9) of the misses with respect to bases and ball."""
    held = _apply(looks.base_from_flange, np.tile(ball, (looks.count, 1)))
    turn = bases[:3, :3]
    slopes = np.zeros((looks.count, 3, BALL.stop))
    slopes[:, :, 0:3] = turn @ np.array([_cross_matrix(one) for one in held])
    slopes[:, :, 3:6] = -np.eye(3)
    slopes[:, :, BALL] = -turn @ looks.base_from_flange[:, :3, :3]
    return slopes


def _place_slope(robot_from_base: Array, place_mm: ArrayLike) -> Array:
    """Return the derivative (3, 6) of a place, given in the robot frame, by the pose of the base."""
    in_base = RigidTransform.from_matrix(robot_from_base).inv().apply(place_mm)
    return np.hstack([-robot_from_base[:3, :3] @ _cross_matrix(in_base), np.eye(3)])


def _apply(pose: Array, points_mm: Array) -> Array:
    """Map points (3,) or (m, 3) by one pose (4, 4), or by a pose each (m, 4, 4)."""
    return np.asarray(RigidTransform.from_matrix(pose).apply(points_mm))


def _cross_matrix(vector: Array) -> Array:
    """Return the matrix (3, 3) of the cross product with a vector."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
