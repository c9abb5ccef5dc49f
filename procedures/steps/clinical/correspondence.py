"""Correspondence of the spheres in CT and room."""

from __future__ import annotations

from math import isinf
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from procedures.engine.context import StepContext
from procedures.engine.methods import NOT_CLINICAL, Matcher
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.guards.errors import BaseShifted
from procedures.guards.room_watch import read_watched
from procedures.journal.results import FramedPose, StepResult, Values
from procedures.operator.question import Task
from procedures.registration.correspondence import Match, MatchStatus
from procedures.registration.errors import HeadElsewhere
from procedures.registration.room_prior import LEAST_APART_MM, RoomPrior, choose_landmark, describe_side
from procedures.registration.surface.starts import Start
from procedures.registration.verification import TwoWayTable, verify_two_way
from procedures.steps.branches import FEWEST_SPHERES, LEAVE_OUT, UNMATCHED_SPHERE
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.coarse_match import coarse_match, match_by_distances, mirror_images, room_prior
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.localized_room import build_watch
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import LeftOutSphere
from procedures.steps.conditions import needs_guide_unmounted
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3
from ronna_hw.frames import Frame, Transform
from ronna_hw.wire.room_tasks import SITE_MARK, TOUCH

FARTHEST_MM = 3000.0  # of a head from the arm's base
READ_AGAIN = (
    "The reading may be mistyped, not in mm, or of another point: repeat the step, touch the point and read "
    "it again. If it stays elsewhere, do not continue with this CT."
)


class TouchedLandmark(Values):
    """Landmark touched on the head, which rules out a mirrored CT."""

    landmark: str = Field(description="Which point.")
    touched_mm: Numbers3 = Field(description="As read, robot frame.")
    off_mm: float = Field(description="Distance from where the match has it.")
    mirrored_mm: float = Field(description="Distance of the nearest mirror image from there.")


class Correspondence(StepResult, kind="correspondence"):
    """Sphere pairs, and the coarse registration derived from them."""

    status: MatchStatus = Field(description="UNIQUE: no other status permits motion.")
    pairs: tuple[tuple[int, int], ...] = Field(description="Index in the CT, index in the room.")
    robot_from_ct: FramedPose = Field(description="Coarse pose robot <- CT.")
    residuals_mm: tuple[float, ...] = Field(description="Of each pair.")
    margin_nats: float | None = Field(
        description="Log-likelihood over the runner-up; none if there is none, or the matcher states no odds."
    )
    two_way: TwoWayTable = Field(description="CT to room and room to CT.")
    left_out: tuple[LeftOutSphere, ...] = Field(
        default=(), description="Implanted spheres that are not where the others predict."
    )
    touched: TouchedLandmark | None = Field(
        default=None, description="None where distances, gravity and sight exclude a mirrored CT."
    )
    matcher: Matcher = Field(default=Matcher.OURS, description="Method of pairing.")
    e_mm: float | None = Field(
        default=None, description="Largest difference of equal distances, of the thesis' matcher."
    )
    refused_share: float | None = Field(
        default=None, description="Share of correct pairings that its validation refuses."
    )


class TouchedPoint(Values):
    """Landmark of the head, in the CT and as it was touched."""

    landmark: str = Field(description="Which one.")
    in_ct_mm: Numbers3 = Field(description="Its place in the CT, LPS.")
    touched_mm: Numbers3 = Field(description="As read, robot frame.")
    off_mm: float = Field(description="Distance from where the fit has it.")


class SurveyedSkin(Values):
    """First looks at the skin, whose pose was searched by what they show alone."""

    looks: int = Field(description="Looks that show a line.")
    lines: int = Field(description="Lines on the skin.")
    points: int = Field(description="Points of the registration.")
    coverage: float = Field(description="Share of the skin above the jaw within 10 mm of a point.")
    rms_mm: float = Field(description="Root mean square of their distances from the skin of the CT.")
    from_measured_mm: float = Field(description="From where the head was measured, at its middle.")
    from_measured_rad: float = Field(description="From how it was measured to be turned.")
    theatre_s: float = Field(description="Theatre time of all looks and the ways to them.")


class SurfaceStart(Correspondence, kind="surface_start"):
    """Coarse pose of a head without markers: by its landmarks, by first looks, or as carried by its clamp."""

    landmarks: tuple[TouchedPoint, ...] = Field(description="As touched, in this order.")
    turn_sd_rad: float = Field(description="Standard deviation of the pose's rotation.")
    place_sd_mm: float = Field(description="Standard deviation of its place.")
    site: TouchedPoint | None = Field(
        default=None,
        description="Mark of an entry on the patient's skin, which tells left from right; none if no entry "
        "is far enough from the middle.",
    )
    carried: str | None = Field(
        default=None, description="Record of the former registration, if the frame on the clamp carried one."
    )

    survey: SurveyedSkin | None = Field(
        default=None, description="First looks at the skin; none if landmarks or the clamp tell the pose."
    )

    @classmethod
    def without_spheres(cls, robot_from_ct: Transform, **fields: object) -> Self:
        """Build the result of a head without spheres; what a correspondence says of them is empty."""
        empty: dict[str, object] = {
            "status": MatchStatus.UNIQUE,
            "pairs": (),
            "robot_from_ct": FramedPose.of(robot_from_ct),
            "residuals_mm": (),
            "margin_nats": None,
            "two_way": verify_two_way(np.empty((0, 3)), np.empty((0, 3)), (), robot_from_ct),
            "landmarks": (),
        }
        return cls.model_validate({**empty, **fields})

    @property
    def placed_by(self) -> str:
        """What has placed the head, in words."""
        if self.carried is not None:
            return "the clamp's frame"
        return "the first looks" if self.survey is not None else "the landmarks"

    @property
    def start(self) -> Start:
        """The pose with its error."""
        touched = np.array([one.in_ct_mm for one in self.landmarks]) if self.landmarks else None
        return Start(self.robot_from_ct.transform, self.turn_sd_rad, self.place_sd_mm, touched)


class MeasuredHead(SurfaceStart, kind="head_measurement"):
    """Rough pose of a head without markers, good enough to send the stereo head for first looks."""


def run(context: StepContext) -> Outcome[Correspondence]:
    """Match the spheres, by the plan's template if it has one. Raises unless the match is unique.

    If a sphere is out of place, the others serve if the operator agrees.
    """
    localization = context.result(LocalizedFiducials)
    room = context.result(GlobalLocalization)
    plan = context.result(CheckedPlan)
    shown = np.array(localization.shown)  # what is matched is counted among them
    image, physical = localization.centres_mm[shown], room.points_mm
    prior = room_prior(plan, context.setting.settings, room.robot_from_tracker.transform)
    methods = context.clinical.methods
    found = coarse_match(plan, localization, physical, prior, methods)
    found, left_out = _match_fewer_if_agreed(context, found, shown, image, physical, prior)
    transform = found.require_unique()
    pairs = np.asarray(found.pairs)
    mirrored = mirror_images(image[pairs[:, 0]], physical[pairs[:, 1]], prior)
    try:
        touched = _touch_if_mirrored(context, transform, mirrored, prior)
    except HeadElsewhere:
        _require_base_in_place(context, room)
        raise
    of_ct = np.column_stack([shown[pairs[:, 0]], pairs[:, 1]])
    table = verify_two_way(
        localization.centres_mm,
        physical,
        of_ct,
        transform,
        ct_disagreement_mm=localization.disagreement_mm,
    )
    residuals = np.linalg.norm(physical[pairs[:, 1]] - transform.apply(image[pairs[:, 0]]), axis=1)
    is_thesis = methods.matcher is Matcher.THESIS
    return Outcome(
        Correspondence(
            status=MatchStatus(found.status),
            pairs=of_ct.tolist(),
            robot_from_ct=FramedPose.of(Transform(Frame.ROBOT, Frame.CT, transform)),
            residuals_mm=residuals.tolist(),
            margin_nats=None if found.margin_nats is None or isinf(found.margin_nats) else found.margin_nats,
            two_way=table,
            left_out=left_out,
            touched=touched,
            matcher=methods.matcher,
            e_mm=methods.e_mm if is_thesis else None,
            refused_share=methods.refused_share if is_thesis else None,
        ),
        summary=f"{len(pairs)} pairs, largest residual {residuals.max():.2f} mm"
        + "".join(f"; without sphere {one.fiducial + 1}" for one in left_out)
        + (f"; the {touched.landmark} is {touched.off_mm:.0f} mm from where it has it" if touched else "")
        + (
            f"; by the thesis' matcher, without odds against another pairing: {NOT_CLINICAL}"
            if is_thesis
            else ""
        ),
    )


def _touch_if_mirrored(
    context: StepContext, robot_from_ct: RigidTransform, mirrored: list[RigidTransform], prior: RoomPrior
) -> TouchedLandmark | None:
    """Ask for a landmark on the head to be touched if a mirrored CT would fit too. Raises REG-013."""
    landmark = choose_landmark(robot_from_ct, mirrored, prior)
    if landmark is None:
        return None
    if landmark.apart_mm < LEAST_APART_MM:
        raise HeadElsewhere(
            "the spheres fit a mirrored CT as well, and no point of the head tells which it is",
            limit=f"{LEAST_APART_MM:g} mm between the {landmark.name} and its mirror image",
            got=f"{landmark.apart_mm:.1f} mm",
            action="Add a sphere outside the plane of the others, and scan again.",
        )
    why = f"the spheres fit a mirrored CT as well: touch the {landmark.name} with the pointer"
    x_mm, y_mm, z_mm = touch_head(context, why, landmark.direction)
    touched_mm = np.array([x_mm, y_mm, z_mm])
    off_mm = float(np.linalg.norm(landmark.matched_mm - touched_mm))
    if off_mm > landmark.limit_mm:
        mirrored_ct = landmark.may_be_mirrored(touched_mm)
        offset_ct_mm = robot_from_ct.rotation.inv().apply(touched_mm - landmark.matched_mm)
        nor = "" if mirrored_ct else ", nor where a mirrored CT would have it"
        raise HeadElsewhere(
            f"the {landmark.name} is not where the match has it{nor}",
            limit=f"{landmark.limit_mm:.0f} mm away",
            # Not the point itself: whoever is to read it again could type it without a look at the scale.
            got=f"{off_mm:.0f} mm away, {describe_side(offset_ct_mm)}",
            action=None if mirrored_ct else READ_AGAIN,
        )
    return TouchedLandmark(
        landmark=landmark.name, touched_mm=(x_mm, y_mm, z_mm), off_mm=off_mm, mirrored_mm=landmark.apart_mm
    )


def touch_head(
    context: StepContext,
    order: str,
    direction: Numbers3 | None = None,
    *,
    site_of: str | None = None,
    task: str = TOUCH,
) -> Numbers3:
    """Have the head touched, or a place of it measured by `task`; return the place as read, robot frame, mm.

    It is touched on the side of a direction (LPS), or at the mark for the entry of the trajectory `site_of`.
    """
    context.workcell.rest()  # hands are at the head: nothing may move the arm meanwhile
    x_mm, y_mm, z_mm = context.perform_task(
        Task(
            task if site_of is None else SITE_MARK,
            f"{order} and read its position in the base of the master ($ROBROOT of a KUKA, Base of a "
            "Universal Robots arm)",
            trajectory=site_of,
            numbers=direction or (),
            reads=("x in mm", "y in mm", "z in mm"),
            plausible_mm=(-FARTHEST_MM, FARTHEST_MM),
        )
    )
    return x_mm, y_mm, z_mm


def _require_base_in_place(context: StepContext, room: GlobalLocalization) -> None:
    """Raise PRO-019 if a point was touched elsewhere because the cart or the tracker was moved meanwhile."""
    name = context.identifier(GlobalLocalization)
    watch = build_watch(context.workcell, context.setting.settings, name, room, None)
    moved = watch.compare(read_watched(watch, context.workcell)).moved
    if isinstance(moved, BaseShifted):
        context.void(LockedCart if moved.cart and context.stands(LockedCart) else GlobalLocalization, moved)
        raise moved


def _match_fewer_if_agreed(
    context: StepContext,
    found: Match,
    shown: NDArray[np.int_],
    image: Array,
    physical: Array,
    prior: RoomPrior,
) -> tuple[Match, tuple[LeftOutSphere, ...]]:
    """If matching fails and the operator agrees, match fewer spheres than were implanted."""
    if found.status not in (MatchStatus.TOO_FEW, MatchStatus.INCONSISTENT):
        return found, ()
    rest = match_by_distances(image, physical, prior, context.clinical.methods)
    if rest.transform is None or rest.status is not MatchStatus.UNIQUE or len(rest.pairs) < FEWEST_SPHERES:
        return found, ()
    places = rest.transform.apply(image)
    nearest_mm = np.linalg.norm(physical[None] - places[:, None], axis=2).min(axis=1)
    left_out = tuple(
        LeftOutSphere(
            fiducial=int(shown[one]),
            reason=f"the tracker sees nothing within {nearest_mm[one]:.1f} mm of its position",
        )
        for one in rest.unmatched_image
    )
    names = " and ".join(str(one.fiducial + 1) for one in left_out)
    question = UNMATCHED_SPHERE.question(
        f"sphere {names} of the CT is missing, on the wrong screw, or has moved",
        "; ".join(f"{one.fiducial + 1}: {one.reason}" for one in left_out)
        + f"; the other {len(rest.pairs)} match, "
        + (
            "and the thesis' matcher states no odds against another pairing"
            if rest.margin_nats is None
            else f"odds against any other pairing e^{rest.margin_nats:.0f}"
        ),
    )
    return (rest, left_out) if context.choose(question) == LEAVE_OUT else (found, ())


STEP = StepSpec(
    Correspondence,
    "Match the spheres of CT and room",
    Phase.PREPARATION,
    run,
    reads=(LocalizedFiducials, GlobalLocalization, CheckedPlan),
    preconditions=needs_guide_unmounted,
)
