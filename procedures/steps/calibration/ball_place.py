"""Calibration ball: coarse position, as stated or from the tracker, and motion of the head over it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field
from scipy.spatial.transform import Rotation

from procedures.calibration.errors import NO_BALL, POSES_OUT_OF_REACH
from procedures.calibration.pose_set import PlannedLook, plan_calibration_looks
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from procedures.relocalization.errors import SphereNotInView
from procedures.relocalization.servo import SEARCH_RADIUS_MM
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.conditions import needs_tool
from procedures.strategies.trajectory import tool_orientation
from procedures.workcell import MountedTool, Workcell
from procedures.workcell.ball_watcher import BallWatcher, build_ball_surroundings
from procedures.workcell.stereo_look import pair_picture
from ronna_hw.arm.errors import NotClear
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_count
from ronna_hw.vectors import JointVector

R = TypeVar("R", bound=StepResult)

DOWN = np.array([0.0, 0.0, -1.0])
ISOLATION_MM = 30.0  # of a ball's nearest neighbour: nearer, both are in view
BALL_PICTURE = "stereo-ball.png"
SPARE = 1.5  # planned looks for each wanted one: some are out of reach, some show a ball half hidden


class BallPlace(StepResult, kind="ball_place"):
    """Coarse positions of the calibration ball and of other balls, robot frame."""

    ball_mm: Numbers3 = Field(description="The ball to measure.")
    others_mm: tuple[Numbers3, ...] = Field(description="Other balls to keep clear of.")

    @classmethod
    def among(cls, points_mm: Array, number: int) -> Self:
        """Select ball `number` among balls at `points_mm` (n, 3); the others are obstacles."""
        x, y, z = points_mm[number].tolist()
        others = tuple((float(u), float(v), float(w)) for u, v, w in np.delete(points_mm, number, axis=0))
        return cls(ball_mm=(x, y, z), others_mm=others)

    @property
    def reference(self) -> Rotation:
        """Orientation robot <- tool looking straight down at the ball, with the mount facing outwards."""
        return tool_orientation(DOWN, np.array(self.ball_mm), 0.0)

    @property
    def first_look(self) -> PlannedLook:
        """Look from above with the ball at the tool centre."""
        pose = Transform.of(
            Frame.ROBOT,
            Frame.TOOL,
            translation_mm=self.ball_mm,
            quaternion_wxyz=self.reference.as_quat(scalar_first=True),
        )
        return PlannedLook(pose, (0.0, 0.0, 0.0))


def run(context: StepContext) -> Outcome[BallPlace]:
    """Choose the isolated ball nearest to the stereo head. Raises CAL-009 if the tracker sees none."""
    points = context.result(GlobalLocalization).points_mm
    isolated_balls = find_isolated(points)
    if not isolated_balls:
        raise NO_BALL("the tracker sees no isolated ball", got=format_count(len(points), "stray sphere"))
    head_mm = context.workcell.master.tool_pose().translation_mm
    chosen = min(isolated_balls, key=lambda number: float(np.linalg.norm(points[number] - head_mm)))
    place = BallPlace.among(points, chosen)
    x, y, z = place.ball_mm
    return Outcome(place, f"{x:.0f} {y:.0f} {z:.0f} mm in $ROBROOT")


def place_step(stated_mm: Numbers3 | None) -> StepSpec[BallPlace]:
    """Build the step that locates the ball, using the stated position instead of the tracker if given."""
    if stated_mm is not None:
        stated = Outcome(BallPlace(ball_mm=stated_mm, others_mm=()), "as stated")
        return StepSpec(BallPlace, "Use the given ball position", Phase.PREPARATION, lambda _context: stated)
    return StepSpec(BallPlace, "Locate the ball", Phase.PREPARATION, run, reads=(GlobalLocalization,))


def find_isolated(points_mm: Array) -> list[int]:
    """Return the indices of the balls (n, 3) that are far enough from every other ball."""
    apart_mm = np.linalg.norm(points_mm[:, None] - points_mm[None], axis=2)
    np.fill_diagonal(apart_mm, np.inf)
    return [number for number, others_mm in enumerate(apart_mm) if others_mm.min() >= ISOLATION_MM]


def bring_over_ball(
    context: StepContext,
    place: BallPlace,
    purpose: str,
    poses: int,
    *,
    ball: str = "the ball",
    if_missing: str | None = None,
) -> BallWatcher:
    """After confirmation, move the head over the ball until it is in view.

    Before anything moves, `poses` poses around the ball must be within reach. Raises CAL-010, PRO-002 unless
    confirmed, STE-009 with the advice `if_missing` if the ball is not found.
    """
    workcell = context.workcell
    ball_mm = np.array(place.ball_mm)
    watcher = BallWatcher(workcell, ball_mm)
    plan = plan_calibration_looks(place.reference, ball_mm, round(SPARE * poses)) if poses else ()
    reached = sum(reachable_joints(workcell, look) is not None for look in plan)
    if reachable_joints(workcell, place.first_look) is None or reached < poses:
        raise POSES_OUT_OF_REACH(
            "the poses around the ball are out of the arm's reach",
            expected=f"{poses} poses",
            got=f"{reached} of {len(plan)}",
        )
    x, y, z = place.ball_mm
    context.confirm(
        Topic.CALIBRATION,
        f"The arm will move around the ball: {purpose}. Nobody and nothing else may be within its reach",
        f"ball at {x:.0f} {y:.0f} {z:.0f} mm in $ROBROOT",
    )
    start_around_ball(context, ball_mm, place.others_mm)
    try:
        seen = watcher.find(place.first_look)
    except SphereNotInView as error:
        raise SphereNotInView(
            f"{ball} was not seen within {SEARCH_RADIUS_MM:g} mm of {x:.0f} {y:.0f} {z:.0f} mm in $ROBROOT",
            got=error.what,
            action=if_missing,
        ) from error
    context.keep_picture(BALL_PICTURE, pair_picture(seen))
    return watcher


def start_around_ball(context: StepContext, ball_mm: ArrayLike, others_mm: ArrayLike = ()) -> None:
    """Surround the stereo head with the ball and others (n, 3), robot frame; start arm and cameras."""
    workcell = context.workcell
    tool = workcell.master.flange_from(MountedTool.STEREO_HEAD)
    workcell.master.surround(build_ball_surroundings(context.setting.surroundings, tool, ball_mm, others_mm))
    workcell.start(cameras=True)
    workcell.sensors.read_whole()


def measuring_step(
    result: type[R], title: str, run: Callable[[StepContext], Outcome[R]], *reads: type[StepResult]
) -> StepSpec[R]:
    """Build a step that moves the stereo head to measure; it reads the set-up and these results."""
    return StepSpec(
        result,
        title,
        Phase.OPERATION,
        run,
        reads=(CheckedSetUp, *reads),
        moves=True,
        preconditions=needs_tool(MountedTool.STEREO_HEAD),
    )


def return_home_if_clear(context: StepContext) -> list[str]:
    """Go home if the path is clear; otherwise stay and return a remark."""
    try:
        context.workcell.master.go_home()
    except NotClear as error:  # raised before anything moved
        return [f"the arm stays where it is: {error.what}"]
    return []


def reachable_joints(workcell: Workcell, look: PlannedLook) -> JointVector | None:
    """Return the joints for a planned look in the arm's home branch, or None if out of reach."""
    try:
        return workcell.master.joints_at(look.pose, workcell.master.home_rad)
    except LimitError:
        return None
