"""Step results used in room comparisons: localized spheres, registration, and check after a target.

They are apart from their steps, which themselves compare the room.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from enum import StrEnum
from typing import Self

import numpy as np
from pydantic import (
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    ValidationError,
    model_validator,
)

from procedures.calibration.base_to_base import meeting_error_mm
from procedures.engine.context import StepContext
from procedures.engine.events import ScanProgress
from procedures.guards.stability import SeenUnchanged, Subject
from procedures.journal.results import FramedPose, Matrix3, StepResult, Values
from procedures.operator.question import PredictedError
from procedures.registration import TwoWayTable
from procedures.registration.surface.changed_skin import ChangedSkin
from procedures.registration.surface.scan import SurfaceScan
from procedures.workcell.supervised_arm import SupervisedArm
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3
from ronna_hw.frames import Transform
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.records import OTHER_VERSION
from ronna_hw.vectors import JointVector

NOT_PREDICTED_OF_TOOL = "an instrument that is bent, or longer than its stop says"
# Rms at the spheres that remains after a rigid fit, as measured in docs/reference/scanner-faults.md.
PATIENT_MOVED = "a patient who moved during the scan: 0.09 mm at the spheres for a motion by 0.3 mm"
NOT_PREDICTED = f"{NOT_PREDICTED_OF_TOOL}; {PATIENT_MOVED}"


Numbers6 = tuple[float, float, float, float, float, float]
UPPER = np.triu_indices(3)  # of a covariance: xx, xy, xz, yy, yz, zz


class LeftOutSphere(Values):
    """Sphere left out of a registration with the operator's agreement."""

    fiducial: int = Field(description="Index of the sphere in the CT.")
    reason: str = Field(description="Why.")


class Relocalization(StepResult, kind="relocalization", version=2):
    """Fine positions of the spheres in the room, by the stereo head.

    Each field has one entry per look: one for each sphere, with strategy `learning` also several.
    """

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
    joints_rad: tuple[JointVector, ...] = Field(description="Joints measured at the last image pair.")
    coarse_offset_mm: Numbers3 | None = Field(
        default=None, description="Mean of fine minus coarse position; null of a scan without spheres."
    )
    axes: tuple[str, ...] = Field(
        default=(),
        description="With strategy `learning`: the axis of each look, a key of `localizations` of the path "
        "check. Several looks may then be at one sphere.",
    )
    left_out: tuple[LeftOutSphere, ...] = Field(default=(), description="Spheres without a measurement.")
    frame_at_home_mm: Numbers3 | None = Field(
        default=None,
        description="In earlier versions: the frame on the arm before, home, by tracker minus by arm.",
    )

    @model_validator(mode="after")
    def _one_entry_for_each_sphere(self) -> Self:
        counts = {len(self.points_robot_mm), len(self.covariances_mm2), len(self.residuals_mm)}
        counts |= {len(self.ray_gaps_mm), len(self.radii_mm), len(self.looks), len(self.joints_rad)}
        if counts != {len(self.fiducials)} or (self.axes and len(self.axes) != len(self.fiducials)):
            raise ValueError("expected one entry for each of the fiducials")
        return self

    @property
    def points_mm(self) -> Array:
        """Spheres (n, 3), robot frame, mm."""
        return np.asarray(self.points_robot_mm, dtype=float).reshape(-1, 3)


class ScannedLine(Values):
    """Points of one line of light on the skin, robot frame, by the nominal tool pose."""

    look: NonNegativeInt = Field(description="Number of the look that it belongs to.")
    joints_rad: JointVector = Field(description="Joints measured there.")
    view_mm: Numbers3 = Field(description="Place of the left camera.")
    points_mm: tuple[Numbers3, ...] = Field(description="Its points.")
    covariances_mm2: tuple[Numbers6, ...] = Field(
        description="Of their measurement alone: xx, xy, xz, yy, yz, zz."
    )


class ScannedLook(Values):
    """One look at the skin, which is kept until the scan is whole."""

    number: NonNegativeInt = Field(description="Of the look, as planned.")
    lines: tuple[ScannedLine, ...] = Field(description="Lines with points, in the order of the scan.")
    reason: str = Field(default="", description="Why a line shows no skin, if one does not.")
    code: str = Field(default="", description="Code of the error that is the reason.")
    theatre_s: float = Field(description="Theatre time that it took, with the way to it.")


class ScannedSurface(Relocalization, kind="surface_scan"):
    """The skin as the stereo head saw it, in the place of spheres or besides some."""

    lines: tuple[ScannedLine, ...] = Field(description="Lines with points, in the order of the scan.")
    planned_looks: int = Field(description="Looks of the path check.")
    dark: dict[str, str] = Field(description="Looks without any line, by their number from 1, and why.")
    covered: float = Field(description="Share of the skin above the jaw within 10 mm of a point.")
    theatre_s: float = Field(description="Theatre time of all looks and the ways to them, without pauses.")
    kept_looks: int = Field(default=0, description="Looks that were taken before the scan was interrupted.")
    progress: ScanProgress | None = Field(
        default=None, description="Its state at the end; null of earlier versions."
    )

    @property
    def scan(self) -> SurfaceScan:
        """The cloud, as a registration takes it."""
        return join_lines(self.lines)

    @property
    def looks_taken(self) -> tuple[int, ...]:
        """Numbers of the looks with points, ascending."""
        return tuple(sorted({line.look for line in self.lines}))

    @classmethod
    def beside(cls, spheres: Relocalization, **fields: object) -> Self:
        """Build the result from a relocalization of spheres, and the lines beside it."""
        return cls.model_validate({**spheres.model_dump(), **fields})

    @classmethod
    def without_spheres(cls, **fields: object) -> Self:
        """Build the result; what a relocalization says of each sphere is empty."""
        empty = dict.fromkeys(
            (
                "fiducials",
                "points_robot_mm",
                "covariances_mm2",
                "residuals_mm",
                "ray_gaps_mm",
                "radii_mm",
                "looks",
                "joints_rad",
            ),
            (),
        )
        return cls.model_validate({**empty, **fields})


def join_lines(lines: Sequence[ScannedLine]) -> SurfaceScan:
    """Return the points of all lines as one scan."""
    return SurfaceScan.join([_as_scan(number, line) for number, line in enumerate(lines)])


def _as_scan(number: int, line: ScannedLine) -> SurfaceScan:
    count = len(line.points_mm)
    covariance = np.empty((count, 3, 3))
    covariance[:, UPPER[0], UPPER[1]] = covariance[:, UPPER[1], UPPER[0]] = line.covariances_mm2
    return SurfaceScan(
        np.array(line.points_mm),
        covariance,
        np.full(count, line.look),
        np.full(count, number),
        np.tile(line.view_mm, (count, 1)),
    )


class ErrorShare(Values):
    """Share of one error source in a predicted error; the shares add up in squares."""

    source: str = Field(description="Such as `CT` or `guide tip`.")
    rms_mm: float = Field(description="Root mean square at the target.")


class Prediction(Values):
    """Predicted error at one target."""

    target: str = Field(description="Name of the trajectory.")
    rms_mm: float = Field(description="Root mean square.")
    limit_mm: float = Field(description="Radius that holds the error with the stated confidence.")
    confidence: float = Field(description="Of that radius, 0 to 1.")
    formula: str = Field(description="Method of prediction.")
    budget: tuple[ErrorShare, ...] = Field(default=(), description="Its contributions.")
    widening: float = Field(
        default=1.0, description="Factor on the errors at the spheres in the limit, by too large a residual."
    )
    excluded: str = Field(default=NOT_PREDICTED, description="Errors that it does not contain.")
    moved_sphere_mm: float | None = Field(
        default=None, description="Shift by one sphere that moved since the scan, until the fit shows it."
    )
    assumed: str = Field(
        default="", description="Errors that a method does not state, and what stands for them."
    )

    def against(self, margin_mm: float) -> PredictedError:
        return PredictedError(
            margin_mm=margin_mm, **self.model_dump(include=set(PredictedError.model_fields))
        )


class FollowedMove(Values):
    """Move of the head since the re-localization, measured by the tracker and accepted by the operator."""

    robot_from_robot: FramedPose = Field(
        description="From the head's previous pose to its present one, robot frame."
    )
    way_mm: float = Field(description="Displacement of the spheres' centroid.")
    turn_deg: float = Field(description="Angle of the rotation.")
    pairs: int = Field(description="Spheres used.")
    residual_mm: float = Field(description="Rms deviation from one rigid motion.")
    limit_mm: float = Field(description="Limit of that residual, from the noise of both readings.")
    base_mm: float = Field(
        description="Motion between the frame on the arm and the tracker since the localization."
    )
    spheres_tracker_mm: tuple[Numbers3, ...] = Field(
        description="All matched spheres now, in the tracker frame of the localization."
    )
    tracker_from_patient: FramedPose | None = Field(
        default=None,
        description="The frame on the head clamp now, in the same; null if not seen or not there.",
    )


class LearnedArm(Values):
    """Errors of the arm as its looks show them, by strategy `learning` or on the skin."""

    looks: int = Field(description="Looks used, all of them for every target.")
    share: float | None = Field(
        default=None,
        description="Size of the arm's errors, as a share of the stated ones; null if not estimated, as "
        "on the skin.",
    )
    scatter_mm: float | None = Field(
        default=None,
        description="Scatter per axis from pose to pose beyond the arm's model; null if not estimated.",
    )
    fiducials: tuple[int, ...] = Field(description="Index of each sphere in the CT.")
    spheres_robot_mm: tuple[Numbers3, ...] = Field(description="Its true place by all looks, robot frame.")
    corrections_mm: dict[str, Numbers3] = Field(
        description="By trajectory: from the target's true place to the one commanded, robot frame."
    )
    correction_limits_mm: dict[str, float] = Field(
        default_factory=dict,
        description="By trajectory: length of a correction that errors of this arm explain, at 99.9 %.",
    )


class RegisteredRobot(StepResult, kind="registration"):
    """Pose of the CT in the robot frame, with the predicted error at its targets."""

    robot_from_ct: FramedPose = Field(
        description="Fine pose robot <- CT of the head as registered, the same for all targets."
    )
    pairs: int = Field(description="Spheres it was fitted to.")
    fre_mm: float = Field(description="Fiducial registration error: not a measure of accuracy.")
    residuals_mm: tuple[Numbers3, ...] = Field(description="Of each sphere, robot frame.")
    leave_one_out_mm: tuple[float | None, ...] = Field(
        description="Residual of each sphere when fitted without it."
    )
    covariances_mm2: tuple[Matrix3, ...] | None = Field(
        default=None,
        description="Total error of each pair that weighted the fit: CT, seating of the sphere, stereo "
        "measurement and arm; robot frame. Null in records of earlier versions.",
    )
    predictions: tuple[Prediction, ...] = Field(description="One for each target it serves.")
    two_way: TwoWayTable = Field(description="CT to room and room to CT.")
    left_out_spheres: tuple[LeftOutSphere, ...] = Field(
        default=(), description="Measured but not used in the fit: they disagree with all others."
    )
    followed: FollowedMove | None = Field(
        default=None, description="The head movement that it follows; everything else is from before that."
    )
    learned: LearnedArm | None = Field(
        default=None,
        description="What all looks show of the arm: with strategy `learning`, or on the skin.",
    )
    left_out: dict[str, str] = Field(
        default={},
        description="Trajectories that it is not accurate enough for, and why; they are not targeted.",
    )

    def leaves_out(self) -> Mapping[str, str]:
        return self.left_out

    @property
    def can_follow(self) -> bool:
        """Whether a small move of the head, which the tracker measures by the spheres, can be followed."""
        return True

    @property
    def trajectories(self) -> frozenset[str]:
        return frozenset(one.target for one in self.predictions)

    def robot_from_ct_at(self, trajectory: str | None) -> Transform:
        """Return the pose robot <- CT that brings the arm to a target, with the correction learned for it."""
        pose, corrections_mm = self.robot_from_ct.transform, self.learned and self.learned.corrections_mm
        if not corrections_mm or trajectory not in corrections_mm:
            return pose
        return pose.displace(corrections_mm[trajectory])

    def correction_mm(self, trajectory: str | None) -> Numbers3:
        """Return the correction learned for a target, (3,) mm, robot frame; zero without one."""
        corrections_mm = {} if self.learned is None else self.learned.corrections_mm
        return corrections_mm.get(trajectory or "", (0.0, 0.0, 0.0))

    def found_in_ct_mm(self, measured: Relocalization) -> dict[int, Array]:
        """Return where the stereo head found each sphere, through this fit, by its index in the CT."""
        fiducials, places_mm = measured.fiducials, measured.points_mm
        if self.learned is not None:
            fiducials, places_mm = self.learned.fiducials, np.array(self.learned.spheres_robot_mm)
        ct_from_robot = self.robot_from_ct.transform.inverse()
        if self.followed is not None:  # they were measured before the head moved
            ct_from_robot = ct_from_robot @ self.followed.robot_from_robot.transform
        return {
            fiducial: ct_from_robot.apply(place_mm)
            for fiducial, place_mm in zip(fiducials, places_mm, strict=True)
        }

    def prediction(self, target: str) -> Prediction:
        """Return the prediction for a target. Raises KeyError."""
        for one in self.predictions:
            if one.target == target:
                return one
        raise KeyError(target)


class SkinRegion(Values):
    """Region of the skin that has probably moved since the CT."""

    parts: tuple[str, ...] = Field(description="Parts of the head.")
    shift_mm: float = Field(description="By how much, outwards.")

    @classmethod
    def of(cls, changed: ChangedSkin) -> SkinRegion:
        return cls(parts=changed.parts, shift_mm=changed.shift_mm)


class RegisteredBySurface(RegisteredRobot, kind="surface_registration"):
    """Pose of the CT in the robot frame by the skin, with the predicted error at its targets."""

    points: int = Field(description="Points of the thinned scan.")
    excluded: float = Field(description="Share of them that is no skin, or changed skin.")
    coverage: float = Field(description="Share of the skin above the jaw near the points used.")
    misfit_mm: float = Field(description="Standard deviation of the skin's misfit, as the scan shows it.")
    misfit_length_mm: float = Field(description="Length over which the misfit is alike.")
    side_proven: bool = Field(
        description="Whether the mirror image fits clearly worse, or a mark on the skin told left from right."
    )
    changed: tuple[SkinRegion, ...] = Field(default=(), description="Regions that have probably moved.")
    carried: bool = Field(
        default=False,
        description="Whether a former registration was carried by the frame on the clamp, and corrected by a "
        "few looks: what is said of the scan is of the former one.",
    )

    confirming_looks: int = Field(
        default=0, description="If carried: looks at skin that was scanned before, which confirm it."
    )

    @property
    def can_follow(self) -> bool:
        """A head without spheres is scanned again: the tracker sees its clamp, not the head in it."""
        return False


class LinkHealth(Values):
    """Counters, turnaround and jitter of the robot link since the arm was last activated, in host time."""

    lock_step: bool = Field(description="Theatre time stood still between telegrams: not a real-time figure.")
    cycles: int = Field(description="Telegrams that were answered.")
    late_cycles: int = Field(description="Replies that came too late, according to the controller.")
    lost_cycles: int = Field(description="Cycles missing from the telegram counter.")
    rejected_telegrams: int = Field(description="Telegrams that were not understood.")
    foreign_telegrams: int = Field(description="Telegrams from another sender.")
    turnaround_median_us: float = Field(description="From telegram to reply.")
    turnaround_p99_us: float = Field(description="99 % within.")
    jitter_median_us: float = Field(description="Of a telegram from its place in the controller's pace.")
    jitter_p99_us: float = Field(description="99 % within.")
    histogram_edges_us: tuple[NonNegativeFloat, ...] = Field(description="Of both histograms.")
    histogram_counts: tuple[NonNegativeInt, ...] = Field(description="Of the turnaround.")
    jitter_counts: tuple[NonNegativeInt, ...] = Field(description="Of the jitter.")

    @model_validator(mode="after")
    def _bins_have_counts(self) -> Self:
        edges, bins = self.histogram_edges_us, max(0, len(self.histogram_edges_us) - 1)
        if len(self.histogram_counts) != bins or len(self.jitter_counts) not in (0, bins):
            raise ValueError(f"expected {bins} counts of turnaround, and as many or none of jitter")
        if any(low >= high for low, high in itertools.pairwise(edges)):
            raise ValueError("the edges of the histograms do not ascend")
        return self


def link_health(context: StepContext, arm: SupervisedArm) -> LinkHealth:
    """Return the health of an arm's link; call this just before its stream ends."""
    statistics = asdict(arm.link_statistics())
    fields = {name: value for name, value in statistics.items() if name in LinkHealth.model_fields}
    return LinkHealth(lock_step=not context.setting.clock.paced, **fields)


def running_link_health(context: StepContext) -> tuple[LinkHealth | None, LinkHealth | None]:
    """Return the health of the links of master and assistant, None for a stream that is not running."""
    master = context.workcell.master
    return link_health(context, master) if master.streaming else None, assistant_link_health(context)


def assistant_link_health(context: StepContext) -> LinkHealth | None:
    """Return the health of the assistant's link, or None without one, or before it streams."""
    streaming = (arm for arm in context.workcell.assistants if arm.streaming)
    return next((link_health(context, arm) for arm in streaming), None)


class AssistedInsertion(Values):
    """Insertion of the instrument by the assistant, as it was watched."""

    off_axis_mm: NonNegativeFloat = Field(description="Over the guide, from its axis, by the joints of both.")
    off_axis_rad: NonNegativeFloat = Field(description="Angle to that axis.")
    seen_apart_mm: NonNegativeFloat | None = Field(
        description="Over the guide, beside the bore by the tracker; none if a frame was hidden."
    )
    seen_within_mm: NonNegativeFloat | None = Field(
        default=None,
        description="Two standard errors of that, along the direction that the looks show least.",
    )
    seen_apart_rad: NonNegativeFloat | None = Field(
        default=None, description="In earlier versions: angle between tracker and joints."
    )
    peak_force_N: NonNegativeFloat | None = Field(
        description="Largest change of the force on the way in; none if the arm senses none."
    )
    force_limit_N: NonNegativeFloat | None = Field(
        default=None, description="Change of the force that stops the way in; none if the arm senses none."
    )
    force_error_N: NonNegativeFloat | None = Field(
        default=None,
        description="Two standard errors of it, by which the arm stops below that; none if it senses none.",
    )
    gap_mm: NonNegativeFloat = Field(description="Between depth stop and guide, as read.")


class FeedEnd(StrEnum):
    """How the last feed of a drill ended."""

    ENDED = "ended"
    INTERRUPTED = "interrupted"  # by a force, a stop or a fault
    UNKNOWN = "not recorded"  # it was begun


class CranialOpening(Values):
    """Opening of the skull by the assistant's drill: depths from the entry along the axis, forces, times."""

    planned_outside_mm: float = Field(description="Outer face of the skull in the CT.")
    planned_inside_mm: float = Field(description="Inner face of the skull in the CT.")
    deepest_mm: float = Field(description="Where the stop of the drill would have rested on the guide.")
    end: FeedEnd = Field(
        default=FeedEnd.ENDED,
        description="How the last feed ended. If that is not recorded, it may have gone to the deepest "
        "place; depth, forces and times are those before it.",
    )
    depth_mm: float = Field(description="Tip of the drill where it stopped, by the joints.")
    resisted_mm: float | None = Field(
        default=None, description="Tip of the drill where bone last resisted; none if none did."
    )
    further_inside_mm: float | None = Field(
        description="Inner face by another reading of the CT that has it deeper; none where there is but one."
    )
    force_fell: bool = Field(
        description="Whether the feed ended because the force fell: nothing is fed deeper there again."
    )
    broke_through: bool = Field(
        description="Whether that is a breakthrough; not where by a reading of the CT bone goes on behind."
    )
    met_bone: bool = Field(description="Whether bone was felt.")
    doubt: str = Field(
        description="What did not agree with the CT, as the operator was asked; '' if nothing."
    )
    accepted: bool = Field(description="Whether the opening counts as drilled, by the CT or the operator.")
    peak_force_N: NonNegativeFloat = Field(description="Largest change of the force.")
    side_force_N: NonNegativeFloat = Field(description="Largest change of the force across the drill's axis.")
    force_limit_N: PositiveFloat = Field(description="Force that stops the drill.")
    force_error_N: NonNegativeFloat = Field(
        description="Two standard errors of the force; the arm stops by as much below the limit."
    )
    drilled_s: NonNegativeFloat = Field(description="Theatre time under way.")
    slowed_s: NonNegativeFloat = Field(description="Of that, with less than the full feed.")
    from_mm: float = Field(description="Where the feed began.")
    forces_N: tuple[NonNegativeFloat, ...] = Field(
        description="Largest forces of the last feed, in equal parts of the way to the deepest place."
    )
    off_axis_mm: NonNegativeFloat = Field(description="Over the guide, from its axis, by the joints of both.")
    seen_apart_mm: NonNegativeFloat | None = Field(
        description="Over the guide, beside the bore by the tracker; none if a frame was hidden."
    )

    @classmethod
    def of_stage(cls, plain: object, trajectory: str) -> Self:
        """Read the opening at a trajectory from the journal. Raises REC-003 if of another version."""
        try:
            return cls.model_validate(plain)
        except ValidationError as error:
            raise OTHER_VERSION(
                f"the opening at {trajectory} in the journal is of another version",
                expected="the fields of this version",
                got="; ".join(describe_mistakes(error)),
            ) from error


class KnownBases(StepResult, kind="base_to_base"):
    """Pose of the assistant's base relative to the master's, with its uncertainty."""

    robot_from_base: FramedPose = Field(description="Pose robot <- base of the assistant.")
    robot_from_tracker: FramedPose = Field(description="Pose robot <- tracker, by the master's turned frame.")
    flange_from_master_frame: FramedPose = Field(description="Pose flange <- frame of the master, as found.")
    flange_from_frame: FramedPose = Field(description="Pose flange <- frame of the assistant, as found.")
    by_frames_mm: float = Field(description="Standard error by the tracker alone, 3-D, where the ball was.")
    error_mm: float = Field(
        description="Standard error, 3-D, with which head and ball meet there on average."
    )
    apart_mm: float = Field(description="How far tracker and stereo head disagree there.")
    scatter_mm: float = Field(description="Of the looks at the ball, per axis.")
    frame_looks: tuple[int, int] = Field(description="Looks at the frames of master and assistant.")
    ball_looks: int = Field(description="Looks at the ball.")
    outliers: int = Field(description="Of these, those left out.")
    master_errors: tuple[float, ...] = Field(description="Of the master, as found; see `FoundArm`.")
    assistant_errors: tuple[float, ...] = Field(description="The same of the assistant.")
    assistant_rad: JointVector = Field(description="Posture of the assistant in the last look.")
    region_mm: Numbers3 = Field(description="Middle of the looks at the ball, robot frame.")
    first_look: NonNegativeInt = Field(
        default=0, description="Number of the look at the room with which this began."
    )
    master_seen_mm: tuple[Numbers3, ...] = Field(
        default=(), description="In earlier versions: frame on the arm and spheres, both arms home."
    )
    assistant_seen_mm: Numbers3 | None = Field(
        default=None, description="In earlier versions: frame of the assistant at home, tracker frame."
    )

    @property
    def meeting_mm(self) -> float:
        """3-D standard error with which head and ball meet once, in a new posture."""
        return meeting_error_mm(self.error_mm, self.scatter_mm)


class ConfirmedTarget(StepResult, kind="confirmation"):
    """Result of the look after a target."""

    seen: tuple[SeenUnchanged, ...] = Field(description="Head, cart and tracker, guide.")
    in_doubt: tuple[str, ...] = Field(description="Targets that may be off by more than was predicted.")
    link: LinkHealth | None = Field(description="Health of the robot link over the gauge; none if unused.")
    assistant_link: LinkHealth | None = Field(
        default=None, description="Health of the assistant's link; none without one."
    )

    def confirms(self, subject: Subject) -> bool:
        """Whether a subject was found unchanged."""
        return any(one.unchanged for one in self.seen if one.subject == subject)
