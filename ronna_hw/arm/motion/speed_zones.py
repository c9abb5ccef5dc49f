"""Where along a path the arm must slow down: near the head, and in some operating modes.

The result is a few steps of the path parameter's speed. The generator follows them; the monitor does not know
them and measures independently.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arm.clearance.swept_path import SweptPath, motion_mm
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.motion.progress import MOST_STEPS, SpeedStep

Array = NDArray[np.float64]

SHARE_OF_CAP = 0.97  # share of a cap used by planning; the rest covers its sampling
ALIKE = 0.95  # neighbouring speeds within this ratio are merged into one step


def with_speed_steps(plan: MotionPlan, path: SweptPath, body_speed_mm_s: float) -> MotionPlan:
    """The plan with its speed steps, so that nothing that moves exceeds the cap at its position.

    `body_speed_mm_s` is the operating mode's limit, wherever it is.
    """
    allowed = np.minimum(allowed_speed(path, body_speed_mm_s), plan.limits.velocity)
    places = np.linspace(0.0, 1.0, MOST_STEPS + 1)
    begins, ends = path.fractions[:-1], path.fractions[1:]
    steps: list[SpeedStep] = []
    for low, high in zip(places[:-1].tolist(), places[1:].tolist(), strict=True):
        velocity = float(allowed[(ends > low) & (begins < high)].min())
        if steps and ALIKE < velocity / steps[-1].velocity < 1.0 / ALIKE:
            steps[-1] = SpeedStep(steps[-1].start, min(velocity, steps[-1].velocity))
        else:
            steps.append(SpeedStep(low, velocity))
    needed = any(step.velocity < plan.limits.velocity for step in steps)
    return replace(plan, speed_steps=tuple(steps) if needed else ())


def allowed_speed(path: SweptPath, body_speed_mm_s: float) -> Array:
    """Largest speed of the path parameter in each interval of a swept path, (n - 1), per s."""
    moved = motion_mm(path.swept).max(axis=1)
    rates = moved / np.diff(path.fractions)
    # Within an interval the rate may exceed its average; the neighbours show by how much.
    padded = np.concatenate([rates[:1], rates, rates[-1:]])
    rates = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    to_head = path.swept.to_head_mm
    with np.errstate(invalid="ignore"):
        nearest = np.where(np.isinf(to_head[:-1]), np.inf, (to_head[:-1] + to_head[1:] - moved) / 2.0)
    nearest = np.maximum(np.minimum(nearest, np.minimum(to_head[:-1], to_head[1:])), 0.0)
    caps = np.array([path.bodies.surroundings.cap_mm_s(distance) for distance in nearest.tolist()])
    caps = np.minimum(caps, body_speed_mm_s)
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(rates > 0.0, SHARE_OF_CAP * caps / rates, np.inf))
