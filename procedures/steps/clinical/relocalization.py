"""Fine localization of every matched sphere by visual servo, oriented as the strategy says.

The tool centre is moved onto a sphere until the residual is below the tolerance. Recorded is the nominal
tool pose plus the last residual. What the first sphere teaches about the offset of the coarse positions
helps to find the next one. It is checked before: a wrong sphere must not lead the head on to the next one.

Where the strategy asks for it, every position that is looked from is approached with each joint turning the
way it will turn on its way to the target, so that backlash is the same in all of them and cancels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from procedures.calibration.arm_sources import ErrorSizes
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.guards.stability import CAREFUL_FRAMES
from procedures.journal.errors import GateFailed
from procedures.journal.results import Matrix3, Numbers6, StepResult
from procedures.relocalization.head_watch import check_head
from procedures.steps.branches import FEWEST_SPHERES, LEAVE_OUT, SPHERE_FAILED
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.paths.previews import in_one_line, motions_over_spheres
from procedures.steps.clinical.paths.surroundings import READS, surround_stereo_head
from procedures.steps.clinical.spheres.left_out import LeftOutSphere
from procedures.steps.clinical.validity.room import ROOM_READS, check_room
from procedures.steps.conditions import REMOUNTED, carries
from procedures.strategies.approach import ONE_SIDE
from procedures.strategies.catalogue import strategy_named
from procedures.workcell import MountedTool
from procedures.workcell.centring import CentredSphere, Centring
from procedures.workcell.stereo_picture import pair_picture
from ronna_hw.calibration import Numbers3
from ronna_hw.errors import RonnaError
from ronna_hw.text.beyond import beyond

Array = NDArray[np.float64]

SMALL_STEPS = "and the small steps over each sphere, or in search of one that is not seen"
SIGMAS = 4.0  # per axis; an error in space is longer in 1 of 1,000 cases


class Relocalization(StepResult, kind="relocalization", version=2):
    """The spheres in the room, finely, as the stereo head sees them. One entry for each sphere."""

    fiducials: tuple[int, ...] = Field(description="Index of each sphere in the CT.")
    points_robot_mm: tuple[Numbers3, ...] = Field(description="Its centre in the robot frame.")
    covariances_mm2: tuple[Matrix3, ...] = Field(description="Of the stereo measurement, robot frame.")
    residuals_mm: tuple[tuple[float, ...], ...] = Field(
        description="Residuals of the servo, image pair by image pair."
    )
    ray_gaps_mm: tuple[float, ...] = Field(description="Distance between the two lines of sight.")
    radii_mm: tuple[tuple[float, float], ...] = Field(
        description="Centres of its outlines, left and right, at the measured position."
    )
    looks: tuple[int, ...] = Field(description="Image pairs taken.")
    joints_rad: tuple[Numbers6, ...] = Field(description="Joints measured at the last image pair.")
    coarse_offset_mm: Numbers3 = Field(description="Mean of fine minus coarse position.")
    left_out: tuple[LeftOutSphere, ...] = Field(default=(), description="Spheres without a measurement.")
    frame_at_home_mm: Numbers3 | None = Field(
        default=None,
        description="The frame on the arm before, home: by the tracker minus by the arm, robot frame.",
    )

    @model_validator(mode="after")
    def _one_entry_for_each_sphere(self) -> Self:
        counts = {len(self.points_robot_mm), len(self.covariances_mm2), len(self.residuals_mm)}
        counts |= {len(self.ray_gaps_mm), len(self.radii_mm), len(self.looks), len(self.joints_rad)}
        if counts != {len(self.fiducials)}:
            raise ValueError("expected one entry for each of the fiducials")
        return self

    @property
    def points_mm(self) -> Array:
        """The spheres (n, 3) in the robot frame."""
        return np.asarray(self.points_robot_mm, dtype=float).reshape(-1, 3)


def run(context: StepContext) -> Outcome[Relocalization]:
    """Re-localize all matched spheres; raises PRO-008 for one that is not there, PRO-009, STE-014."""
    paths = context.result(CheckedPaths)
    motions = motions_over_spheres(paths.motions, context.key.trajectory)
    course = f"{in_one_line(motions)}; {SMALL_STEPS}" if motions else ""
    with context.workcell.supervised.leading(course):
        return _localized(context, paths)


def _localized(context: StepContext, paths: CheckedPaths) -> Outcome[Relocalization]:
    planned = paths.localizations_for(context.key.trajectory)
    workcell, settings = context.workcell, context.setting.settings
    workcell.check_mounted(MountedTool.STEREO_HEAD)
    surround_stereo_head(context, planned[len(planned) // 2].joints_rad)
    where, frame_mm = "before the spheres are localized again", None
    if workcell.place.is_home or not context.stands(Relocalization):  # what moves from here on shows at home
        check_room(context, where)
        workcell.start(cameras=True)
        workcell.return_home()
        frame_mm = check_room(context, where, CAREFUL_FRAMES).reading.frame_mm
        if frame_mm is None:
            raise GateFailed(
                f"{where}, the tracker does not see the frame on the arm",
                expected="the frame in view, with the arm home",
                action="Clear the line of sight between tracker and arm, then repeat the step.",
            )
    else:
        check_room(context, where)
        workcell.start(cameras=True)
    centring = Centring(
        workcell,
        arriving=arriving(context, paths),
        area_px=settings.servo_area_px,
        approach_mm=settings.approach_mm,
    )
    offset_mm = np.zeros(3)
    offsets_mm: list[Array] = []
    spheres: list[CentredSphere] = []
    left_out: list[LeftOutSphere] = []
    for number, item in enumerate(planned):
        context.progress(number / len(planned), f"centring sphere {item.fiducial + 1}")
        coarse = item.tool_pose.transform
        if spheres:  # the pose is displaced by what was seen: so is the head beside which the arm goes there
            surround_stereo_head(context, item.joints_rad, offset_mm=offset_mm)
        try:
            sphere = centring.onto(item.fiducial, coarse.displaced(offset_mm), item.approach_rad)
        except SPHERE_FAILED.errors as problem:
            left_out.append(_agreed(context, item.fiducial, problem, len(planned) - len(left_out) - 1))
            centring.back_off()
            continue
        name = f"stereo-{context.key.trajectory or 'all'}-{item.fiducial + 1}.png"
        context.keep_picture(name, pair_picture(sphere.last_look))
        offset_mm = sphere.point_mm - coarse.translation_mm
        offsets_mm.append(offset_mm)
        spheres.append(sphere)
        _check_last(offsets_mm, [one.fiducial for one in spheres], context)
    gaps_mm = tuple(sphere.ray_gap_mm for sphere in spheres)
    radii_mm = tuple(sphere.radii_mm for sphere in spheres)
    stated_mm = workcell.calibrations.stereo_head.stated_error_mm
    check_head(radii_mm, gaps_mm, stated_mm, settings.sphere_diameter_mm)
    check_room(context, "after the spheres were localized again")
    return Outcome(
        Relocalization(
            fiducials=tuple(sphere.fiducial for sphere in spheres),
            points_robot_mm=tuple(sphere.point_mm.tolist() for sphere in spheres),
            covariances_mm2=tuple(sphere.covariance_mm2.tolist() for sphere in spheres),
            residuals_mm=tuple(sphere.residuals_mm for sphere in spheres),
            ray_gaps_mm=gaps_mm,
            radii_mm=radii_mm,
            looks=tuple(sphere.looks for sphere in spheres),
            joints_rad=tuple(sphere.joints_rad for sphere in spheres),
            coarse_offset_mm=np.mean(offsets_mm, axis=0).tolist(),
            left_out=tuple(left_out),
            frame_at_home_mm=None if frame_mm is None else tuple(frame_mm.tolist()),
        ),
        summary=(
            f"{len(spheres)} spheres, largest final residual "
            f"{max(sphere.residuals_mm[-1] for sphere in spheres):.3f} mm"
        )
        + "".join(f"; without sphere {one.fiducial + 1}" for one in left_out),
    )


def arriving(context: StepContext, paths: CheckedPaths) -> tuple[int, ...] | None:
    """Direction in which each joint arrives at the spheres; None when the strategy does not control it.

    It is that in which the joint will arrive at the target. Where one registration serves all targets, a
    calibrated arm arrives from one side: its backlash is known and counts only where it is known on which
    side a joint rests.
    """
    if context.key.trajectory is None and context.workcell.calibrations.arm is not None:
        return ONE_SIDE
    if (
        context.key.trajectory is None
        or not strategy_named(paths.strategy_of(context.trajectory)).controls_approach
    ):
        return None
    return paths.targets[context.trajectory].approach_signs


def _agreed(context: StepContext, fiducial: int, problem: RonnaError, remain: int) -> LeftOutSphere:
    """The operator agrees to do without a sphere; raises `problem` when not, or when too few remain."""
    if remain < FEWEST_SPHERES:
        raise problem
    question = SPHERE_FAILED.question(
        f"sphere {fiducial + 1} cannot be measured",
        f"{problem.summary}; {remain} spheres would remain without it",
        context.key.trajectory,
    )
    if context.choose(question) != LEAVE_OUT:
        raise problem
    return LeftOutSphere(fiducial=fiducial, reason=problem.summary)


def _check_last(offsets_mm: Sequence[Array], fiducials: Sequence[int], context: StepContext) -> None:
    """A sphere whose offset differs from those before is another one, or the patient moved.

    What all spheres share is the error of tool frame and tracker frame: it alone bounds the first offset.
    """
    *before, last = offsets_mm
    limit_mm = context.setting.settings.coarse_fine_limit_mm
    *others, name = (f"sphere {one + 1}" for one in fiducials)
    if not before:
        limit_mm += _shared_mm(context)
        before = [np.zeros(3)]
    elif len(before) == 1:  # which of two is wrong nobody knows
        name = f"{others[0]} or {name}"
    apart_mm = max(math.dist(last, one) for one in before)
    if apart_mm > limit_mm:
        raise GateFailed(
            f"{name} is not where the tracker saw it",
            limit=f"{limit_mm:.3g} mm",
            got=f"{beyond(apart_mm, limit_mm, 2)} mm",
            action="Check that the patient has not moved, then localize with the tracker again.",
        )


def _shared_mm(context: StepContext) -> float:
    """How far tool frame and tracker frame may put the coarse position off: both turn with the tool.

    The tracker looks in one orientation, the stereo head in another: at most the error counts twice.
    """
    records = context.workcell.calibrations
    tool_mm = ErrorSizes.stated(context.setting.settings, records.arm).tool_mm
    return 2.0 * SIGMAS * math.hypot(tool_mm, records.tracker_frame.stated_error_mm)


STEP = StepSpec(
    Relocalization,
    "Re-localize the spheres with the stereo head",
    Phase.OPERATION,
    run,
    scope=Scope.LOCALIZATION,
    reads=(CheckedPaths, *ROOM_READS, *READS),
    moves=True,
    preconditions=carries(MountedTool.STEREO_HEAD, REMOUNTED),
)
