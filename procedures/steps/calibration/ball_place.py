"""Where the ball is before the head has seen it: as the operator says, or as the tracker sees it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import Rotation

from procedures.calibration.errors import NoBall
from procedures.calibration.pose_set import PlannedLook
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.results import StepResult
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.strategies.orientation import tool_orientation
from ronna_hw.calibration import Numbers3
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

DOWN = np.array([0.0, 0.0, -1.0])
ALONE_MM = 30.0  # of a ball's nearest neighbour: nearer, both are in view


class BallPlace(StepResult, kind="ball_place"):
    """Coarse place of the ball and of other balls, robot frame."""

    ball_mm: Numbers3 = Field(description="The ball to measure.")
    others_mm: tuple[Numbers3, ...] = Field(description="Other balls to keep clear of.")

    @classmethod
    def among(cls, points_mm: Array, number: int) -> Self:
        """One of the balls (n, 3)."""
        x, y, z = points_mm[number].tolist()
        others = tuple((float(u), float(v), float(w)) for u, v, w in np.delete(points_mm, number, axis=0))
        return cls(ball_mm=(x, y, z), others_mm=others)

    @property
    def reference(self) -> Rotation:
        """Orientation robot <- tool that looks straight down on the ball, mount turned outwards."""
        return tool_orientation(DOWN, np.array(self.ball_mm), 0.0)

    @property
    def first_look(self) -> PlannedLook:
        """The ball in the tool centre, looked at from above."""
        pose = Transform.of(
            Frame.ROBOT,
            Frame.TOOL,
            translation_mm=self.ball_mm,
            quaternion_wxyz=self.reference.as_quat(scalar_first=True),
        )
        return PlannedLook(pose, (0.0, 0.0, 0.0))


@dataclass(frozen=True)
class StatedPlace:
    """The place that the operator states, in the robot frame."""

    ball_mm: Numbers3

    def run(self, _context: StepContext) -> Outcome[BallPlace]:
        """Take it as it is."""
        return Outcome(BallPlace(ball_mm=self.ball_mm, others_mm=()), "as stated")


def run(context: StepContext) -> Outcome[BallPlace]:
    """By the tracker: the ball nearest to the head in its present pose. Raises CAL-009.

    The arm rests, as the localization by the tracker wants it.
    """
    points = context.result(GlobalLocalization).points_mm
    alone = standing_alone(points)
    if not alone:
        raise NoBall("the tracker sees no isolated ball", got=f"{len(points)} stray spheres")
    head_mm = context.workcell.tool_pose().translation_mm
    chosen = min(alone, key=lambda number: float(np.linalg.norm(points[number] - head_mm)))
    place = BallPlace.among(points, chosen)
    x, y, z = place.ball_mm
    return Outcome(place, f"{x:.0f} {y:.0f} {z:.0f} mm in $ROBROOT")


def place_step(stated_mm: Numbers3 | None) -> StepSpec[BallPlace]:
    """The step; with a stated place the tracker is not asked."""
    if stated_mm is not None:
        return StepSpec(
            BallPlace, "Use the given ball position", Phase.PREPARATION, StatedPlace(stated_mm).run
        )
    return StepSpec(BallPlace, "Locate the ball", Phase.PREPARATION, run, reads=(GlobalLocalization,))


def standing_alone(points_mm: Array) -> list[int]:
    """Numbers of the balls (n, 3) that are far enough from every other one."""
    return [number for number in range(len(points_mm)) if _nearest_mm(points_mm, number) >= ALONE_MM]


def _nearest_mm(points: Array, number: int) -> float:
    others = np.delete(points, number, axis=0)
    return float(np.linalg.norm(others - points[number], axis=1).min()) if len(others) else np.inf
