"""Control law for moving the tool centre point onto a sphere, and the sphere search pattern.

The residual is the sphere's centre in the tool frame; the law leads from a measured residual to the next
pose. The loop that moves the arm and takes the images is in the workcell; it keeps a `ServoState` and queries
it after each measurement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from procedures.relocalization.errors import BAD_MEASUREMENT, SERVO_DIVERGES, SERVO_EXHAUSTED, SphereNotInView
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arrays import Array
from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform
from ronna_hw.text import format_count
from ronna_hw.vectors import Vector3, vector3

KR6_SCATTER_MM = find_arm("kr6_r900_sixx").repeatability_mm
RINGS = 3
RING_STEP_MM = 5.0
SEARCH_RADIUS_MM = RINGS * RING_STEP_MM
LOOKS_PER_RING = 6  # on the first; each further ring has that many more, so that looks stay about 5 mm apart


@dataclass(frozen=True)
class ServoSettings:
    """Servo settings. `tolerance_mm` is the termination criterion (thesis: 0.03 mm).

    A measurement of the sphere is wrong by the arm's repeatability and by a share of the remaining distance:
    head and arm are slightly rotated and scaled against their calibration records.
    """

    tolerance_mm: float = 0.03
    steps: int = 15
    step_limit_mm: float = 10.0  # one step never moves the tool further: a wrong residual does no harm
    repeatability_mm: float = 0.03  # of the arm; KR 6 R900, ISO 9283
    way_error: float = 0.01  # share of the remaining distance: 0.6 degrees, or 1 % of scale (U)
    shrink: float = 0.8  # the residual must shrink to this share ...
    trend_steps: int = 2  # ... within this many steps
    noise_mm: float = 0.12  # below this the arm's repeatability masks the trend

    @classmethod
    def for_arm(cls, scatter_mm: float) -> Self:
        """Return settings for an arm that rests within `scatter_mm` per axis, one standard deviation.

        The lengths above are for the KR 6 R900; a less repeatable arm cannot end as close.
        """
        usual, scale = cls(), max(1.0, scatter_mm / KR6_SCATTER_MM)
        return cls(
            tolerance_mm=scale * usual.tolerance_mm,
            repeatability_mm=scale * usual.repeatability_mm,
            noise_mm=scale * usual.noise_mm,
        )


@dataclass(frozen=True)
class ServoState:
    """Measurements so far, oldest first: residuals in mm, and implied sphere positions in robot mm."""

    settings: ServoSettings = ServoSettings()
    residuals_mm: tuple[float, ...] = ()
    points_mm: tuple[Vector3, ...] = ()

    @property
    def converged(self) -> bool:
        """Whether the last residual meets the termination criterion."""
        return bool(self.residuals_mm) and self.residuals_mm[-1] <= self.settings.tolerance_mm

    @property
    def step_count(self) -> int:
        """Number of motions made between the measurements so far."""
        return max(0, len(self.residuals_mm) - 1)

    def with_measurement(self, tool_pose: Transform, residual_mm: ArrayLike) -> ServoState:
        """Return the state with one more residual (3,) in the tool frame, measured at the pose ROBOT <- TOOL.

        Raises STE-007 when the residuals do not shrink, STE-008 when no steps are left.
        """
        residual = _validate_residual(residual_mm)
        length = float(np.linalg.norm(residual))
        point_mm = vector3(recorded_point(tool_pose, residual))
        state = replace(
            self, residuals_mm=(*self.residuals_mm, length), points_mm=(*self.points_mm, point_mm)
        )
        if state.converged:
            return state
        state._require_trend()
        if state.step_count >= self.settings.steps:
            raise SERVO_EXHAUSTED(
                f"the servo has not converged after {format_count(state.step_count, 'step')}",
                expected=f"a residual of at most {self.settings.tolerance_mm} mm",
                got=f"{length:.3f} mm",
            )
        return state

    def next_pose(self, tool_pose: Transform) -> Transform:
        """Return the next pose ROBOT <- TOOL: same orientation, tool centre on the mean of all measurements.

        Near the sphere, most of the residual is the arm's repeatability. Following the last measurement alone
        would answer each random error with another, so every measurement counts, weighted by its uncertainty.
        """
        _require_tool_pose(tool_pose)
        if not self.points_mm:
            raise BAD_MEASUREMENT("the sphere has not been measured yet")
        way_errors_mm = self.settings.way_error * np.array(self.residuals_mm)
        weights = 1.0 / (self.settings.repeatability_mm**2 + way_errors_mm**2)
        step = np.average(self.points_mm, axis=0, weights=weights) - tool_pose.translation_mm
        length = float(np.linalg.norm(step))
        if length > self.settings.step_limit_mm:
            step *= self.settings.step_limit_mm / length
        return _move_to(tool_pose, tool_pose.translation_mm + step)

    def _require_trend(self) -> None:
        span = self.settings.trend_steps
        if len(self.residuals_mm) <= span:
            return
        earlier_mm, latest_mm = self.residuals_mm[-1 - span], self.residuals_mm[-1]
        if latest_mm > self.settings.noise_mm and latest_mm > self.settings.shrink * earlier_mm:
            raise SERVO_DIVERGES(
                f"the residual has not decreased within {span} steps",
                expected=f"at most {self.settings.shrink * earlier_mm:.3f} mm",
                got=" ".join(f"{value:.3f}" for value in self.residuals_mm) + " mm",
            )


def recorded_point(tool_pose: Transform, residual_mm: ArrayLike) -> Array:
    """Return the sphere centre in the robot frame, (3,) mm, from nominal tool pose and residual.

    Since the residual is added rather than driven to zero, the end condition costs no accuracy.
    """
    _require_tool_pose(tool_pose)
    return tool_pose.apply(_validate_residual(residual_mm))


def _validate_residual(residual_mm: ArrayLike) -> Array:
    residual = np.array(residual_mm, dtype=float)
    if residual.shape != (3,) or not all(math.isfinite(value) for value in residual):
        raise BAD_MEASUREMENT("a residual is three finite numbers in mm", got=str(residual_mm))
    return residual


def _require_tool_pose(pose: Transform) -> None:
    if (pose.target, pose.source) != (Frame.ROBOT, Frame.TOOL):
        raise FRAME_MISMATCH(f"a tool pose is robot <- tool, not {pose.target} <- {pose.source}")


def search_offsets_mm() -> Array:
    """Return the search offsets (n, 3) mm in the tool frame: rings across the tool axis, innermost first.

    The first pose itself is left out. Each ring starts where the previous one ended, so the head moves in a
    spiral.
    """
    offsets, first = [], 0.0
    for ring in range(1, RINGS + 1):
        ring_poses = LOOKS_PER_RING * ring
        angles = first + np.arange(ring_poses) * (2.0 * np.pi / ring_poses)
        radius = ring * RING_STEP_MM
        offsets += [(radius * np.cos(angle), radius * np.sin(angle), 0.0) for angle in angles]
        first = float(angles[-1])
    return np.array(offsets).reshape(-1, 3)


def search_pose(start: Transform, look_number: int) -> Transform:
    """Return search pose `look_number` (from 0), oriented like `start`. Raises STE-009 after the last."""
    offsets = search_offsets_mm()
    if look_number >= len(offsets):
        raise SphereNotInView(
            f"no sphere in {len(offsets)} image pairs", limit=f"{SEARCH_RADIUS_MM:g} mm around the pose"
        )
    return _move_to(start, start.apply(offsets[look_number]))


def _move_to(pose: Transform, place_mm: Array) -> Transform:
    return Transform.of(
        pose.target, pose.source, translation_mm=place_mm, quaternion_wxyz=pose.quaternion_wxyz
    )
