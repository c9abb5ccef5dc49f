"""Arm calibration with stationary spheres: links, joints, gravity, backlash, and the stereo head's pose.

Weighted least squares with prior set S. The positions of the spheres are not known beforehand, so the arm's
pose in the room remains undetermined, and need not be known: a case measures its spheres with the same arm.
The arm's random error is estimated from the measurements themselves, accounting for the leverage of each in
the fit. Held-out measurements validate the result; the records of arm, head and tip follow from it.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from procedures.calibration.arm_model import BACKLASH, ArmLooks, ArmModel, LookArrays, arrays_of
from procedures.calibration.errors import UNOBSERVABLE, DoesNotFit
from procedures.calibration.head_calibration import LIFE, move_tip, new_identifier
from procedures.calibration.head_model import pose_record
from procedures.calibration.pose_set import (
    plan_centred_looks,
    require_consistent,
    require_count,
    require_scatter,
    require_spread,
    rms_mm,
)
from procedures.registration.error_theory import propagate
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array, Mask
from ronna_hw.calibrated_arm.deviations import ArmDeviations
from ronna_hw.calibration import ArmCalibration, StereoHeadCalibration, ToolTipCalibration
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_against_limit, format_distinct

LEAST_LOOKS = 60  # with fewer, validation shows errors beyond those of a calibrated arm
ROUNDS = 6  # of fit, estimate of the random error, and outlier rejection: they converge within four
FIRST_SCATTER_MM = 0.05
LEAST_SCATTER_MM = 0.003  # no arm is better
LARGEST_SCATTER_MM = 0.15  # no arm of this class is worse: something moved
OUTLIER_CHI2 = 16.3  # exceeded by 0.1 % of good measurements, with three coordinates
MOST_OUTLIERS = 0.1

LEAST_VALIDATION = 12
ACCEPTED = 1e-4  # probability of rejecting a good calibration
LARGEST_ERROR_MM = 0.10  # of the model around a sphere: twice that of a good calibration
LOOKS_AROUND = 24  # poses around each sphere, as they are usually planned
LEAST_LEARNT = 0.5  # of a joint's backlash: 0.02 to 0.07 is usual
MODEL_SHARE = 0.25  # of the predicted variance: harmonics beyond the second, flexible links

MADE_BY = "ronna-arm calibrate"
DIGITS = 5  # of the covariance: large errors cancel to some hundredths of them


@dataclass(frozen=True)
class ArmResult:
    """New records and their quality; `tool_shift_mm` is how far the head's tool centre shifted.

    Head and tip keep their dates: only the head's place on the flange was measured, not cameras and tip.
    """

    fit: ArmFit
    validation: ArmValidation
    arm: ArmCalibration
    stereo_head: StereoHeadCalibration
    tool_tip: ToolTipCalibration | None
    tool_shift_mm: float


def calibrate_arm(observed: ArmLooks, *, life: timedelta = LIFE) -> ArmResult:
    """Compute dated records from measurements. Raises CAL-002 to CAL-004, CAL-011."""
    head = observed.stereo_head
    before = head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    identified = {one.sphere for one in observed.looks if not one.validation}
    # A sphere that was only validated has no fitted position to compare with.
    usable = [one for one in observed.looks if one.sphere in identified]
    looks = arrays_of(usable)
    held_out = np.array([one.validation for one in usable], dtype=bool)
    fit = identify(ArmModel(find_arm(observed.arm).kinematics, before), looks.only(~held_out))
    validation = validate(fit, looks.only(held_out))
    after = fit.flange_from_tool
    tip = None if observed.tool_tip is None else move_tip(observed.tool_tip, before, after)
    return ArmResult(
        fit=fit,
        validation=validation,
        arm=ArmCalibration(
            identifier=new_identifier("arm", observed.created),
            stated_error_mm=validation.model_mm,
            arm=observed.arm,
            serial=observed.arm_serial or None,
            stereo_head_mm=pose_record(after).translation_mm,
            tool_tip_mm=None if tip is None else tip.flange_from_tool.translation_mm,
            scatter_mm=fit.scatter_mm,
            **fit.deviations.as_plain(),
            remaining=tuple(
                tuple(float(f"{value:.{DIGITS}g}") for value in row[: number + 1].tolist())
                for number, row in enumerate(fit.remaining)
            ),
            freedom=round(fit.freedom, 1),
            created=observed.created,
            expires=observed.created + life,
            made_by=MADE_BY,
        ),
        stereo_head=head.model_copy(
            update={
                "identifier": new_identifier("stereo-head", observed.created),
                "flange_from_tool": pose_record(after),
                "made_by": MADE_BY,  # by another method: not compared with one of the head alone
            }
        ),
        tool_tip=tip,
        tool_shift_mm=float(np.linalg.norm(after.translation_mm - before.translation_mm)),
    )


@dataclass(frozen=True)
class ArmFit:
    """Identified arm. `values` and their `covariance` (n, n) are ordered and scaled as in `ArmModel`.

    `scatter_mm` is the random error of the arm per axis; `residuals_mm` (m, 3) in the robot frame; `used`
    (m,) marks the inliers.
    """

    model: ArmModel
    values: Array
    covariance: Array
    scatter_mm: float
    residuals_mm: Array
    used: Mask

    @property
    def deviations(self) -> ArmDeviations:
        """Identified deviations of the arm from its nominal chain."""
        return self.model.deviations(self.values)

    @property
    def flange_from_tool(self) -> Transform:
        """Identified pose FLANGE <- TOOL of the head."""
        return self.model.tool(self.values)

    @property
    def learnt(self) -> Array:
        """Standard error of each parameter relative to its prior, excluding the sphere positions."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[: self.model.size]))

    @property
    def freedom(self) -> float:
        """Degrees of freedom of `scatter_mm`: coordinates less what the fit has learnt from them.

        A parameter that keeps a share of its prior variance has cost only the rest of a degree.
        """
        places = len(self.values) - self.model.size
        return 3.0 * int(self.used.sum()) - places - float(np.sum(1.0 - self.learnt**2))

    @property
    def remaining(self) -> Array:
        """Lower triangular root (k, k) of the covariance of an arm record's contents, for any spheres."""
        size = self.model.size
        root = self.model.to_record @ np.linalg.cholesky(self.covariance[:size, :size])
        _, upper = np.linalg.qr(root.T)
        lower = np.zeros((len(root), len(root)))
        lower[:, : len(upper)] = upper.T
        return lower


def identify(model: ArmModel, looks: LookArrays) -> ArmFit:
    """Identify the arm that best explains the measurements. Raises CAL-002, CAL-003, CAL-004."""
    count = len(looks.joints_rad)
    require_count(count, LEAST_LOOKS, "too few measurements to calibrate an arm")
    rotations = model.rotations(looks)
    require_spread(rotations, "the orientations of the measurements hardly vary")
    stereo = propagate(rotations, looks.covariances_mm2)
    values = _initial_values(model, looks)
    scatter, used = FIRST_SCATTER_MM, np.ones(count, dtype=bool)
    for _ in range(ROUNDS):
        whitening = whitening_of(stereo, scatter)
        slopes = model.slopes(values, looks)
        covariance, values = _step(model, looks, values, slopes, whitening, used)
        residuals = model.misses(values, looks)
        scatter = _estimate_scatter(residuals, propagate(slopes, covariance), stereo, used)
        whitened = np.einsum("mij,mj->mi", whitening_of(stereo, scatter), residuals)
        used = np.sum(whitened**2, axis=1) < OUTLIER_CHI2
    require_scatter(scatter, LARGEST_SCATTER_MM, "spheres seem to move between measurements")
    require_consistent(used, MOST_OUTLIERS, "looks")
    return ArmFit(model, values, covariance, scatter, residuals, used)


def whitening_of(stereo_mm2: Array, scatter_mm: float) -> Array:
    """Return matrices (m, 3, 3) that whiten misses with these stereo covariances and this random error."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(stereo_mm2 + scatter_mm**2 * np.eye(3))))


def _initial_values(model: ArmModel, looks: LookArrays) -> Array:
    """Return start values: the nominal arm, with each sphere at the median of its measurements."""
    values = np.zeros(model.size + 3 * looks.spheres)
    offsets_mm = model.misses(values, looks)
    places = [np.median(offsets_mm[looks.sphere == number], axis=0) for number in range(looks.spheres)]
    values[model.size :] = np.ravel(places)
    return values


def _step(
    model: ArmModel, looks: LookArrays, values: Array, slopes: Array, whitening: Array, used: Mask
) -> tuple[Array, Array]:
    """Take one Gauss-Newton step; return the covariance and the new parameters."""
    rows = (whitening @ slopes)[used].reshape(-1, len(values))
    misses = np.einsum("mij,mj->mi", whitening, model.misses(values, looks))[used].ravel()
    prior = np.zeros(len(values))
    prior[: model.size] = 1.0
    covariance: Array = np.asarray(np.linalg.inv(rows.T @ rows + np.diag(prior)), dtype=float)
    return covariance, values - covariance @ (rows.T @ misses + prior * values)


def _estimate_scatter(residuals: Array, explained: Array, stereo: Array, used: Mask) -> float:
    """Estimate the arm's random error per axis in mm, from the residuals in excess of image noise.

    `explained` (m, 3, 3) is the covariance of the fit at the measurements, by which it has shrunk the
    residuals.
    """
    square = np.sum(residuals**2, axis=1) - np.einsum("mii->m", stereo) + np.einsum("mii->m", explained)
    return float(max(np.sqrt(max(np.mean(square[used]) / 3.0, 0.0)), LEAST_SCATTER_MM))


@dataclass(frozen=True)
class ArmValidation:
    """Validation by held-out measurements. `misses_mm` is (m, 3); other values are 3-D rms in mm.

    `before_mm` is the nominal arm's error there, `predicted_mm` the error expected from the model's
    covariance and the random error, `model_mm` the model's part of it.
    """

    misses_mm: Array
    before_mm: float
    error_mm: float
    predicted_mm: float
    model_mm: float


def validate(fit: ArmFit, looks: LookArrays) -> ArmValidation:
    """Validate a fit with held-out measurements. Raises CAL-002, CAL-004, CAL-011."""
    count = len(looks.joints_rad)
    require_count(count, LEAST_VALIDATION, "too few measurements to validate the arm")
    _require_both_sides(fit)
    model, rotations = fit.model, fit.model.rotations(looks)
    misses, slopes = model.misses(fit.values, looks), model.slopes(fit.values, looks)
    fit_mm2 = propagate(slopes, fit.covariance)
    random_mm2 = propagate(rotations, looks.covariances_mm2) + fit.scatter_mm**2 * np.eye(3)
    model_mm, around_mm = _size_mm(fit_mm2), _around_spheres_mm(fit, looks)
    if around_mm > LARGEST_ERROR_MM:
        worst = np.argsort(fit.learnt)[::-1][:3]
        raise UNOBSERVABLE(
            "the measurements do not determine enough of the arm: least of all "
            + ", ".join(model.names[number] for number in worst),
            limit=f"{LARGEST_ERROR_MM:g} mm in all orientations around the spheres",
            got=f"{format_against_limit(around_mm, LARGEST_ERROR_MM, 2)} mm",
        )
    whitened = np.einsum("mij,mj->mi", whitening_of(fit_mm2 + random_mm2, 0.0), misses)
    statistic, limit = float(np.sum(whitened**2)), float(chdtri(3 * count, ACCEPTED)) * (1.0 + MODEL_SHARE)
    if statistic > limit:
        got, refused_from = format_distinct(statistic, limit, 0)
        raise DoesNotFit(
            "the identified arm does not agree with the measurements kept for validation",
            limit=f"chi-square {refused_from}",
            got=f"{got}: {rms_mm(misses):.3f} mm",
        )
    return ArmValidation(
        misses_mm=misses,
        before_mm=_nominal_error_mm(fit, looks),
        error_mm=rms_mm(misses),
        predicted_mm=_size_mm(fit_mm2 + random_mm2),
        model_mm=model_mm,
    )


def _require_both_sides(fit: ArmFit) -> None:
    """Raise CAL-011 if any joint always arrived from the same side.

    Its backlash shows in no measurement, held out or not.
    """
    unknown = [
        name
        for name, share in zip(fit.model.names, fit.learnt.tolist(), strict=True)
        if name.endswith(BACKLASH) and share > LEAST_LEARNT
    ]
    if unknown:
        raise UNOBSERVABLE(
            f"the measurements do not determine the {', '.join(unknown)}: these joints "
            "arrived from one side only",
            limit=f"{LEAST_LEARNT:g} of the prior uncertainty",
            got="all of it",
        )


def _around_spheres_mm(fit: ArmFit, looks: LookArrays) -> float:
    """Return the error that the fit leaves over all usual orientations, as 3-D rms in mm.

    Held-out measurements share the orientations of the others, so they reveal nothing about the rest.
    """
    model, near = fit.model, looks.joints_rad[0]
    reference = Rotation.from_matrix(model.rotations(looks)).mean()
    branch, joints, spheres = model.kinematics.branch_of(near), [], []
    for number, place in enumerate(fit.values[model.size :].reshape(-1, 3)):
        for look in plan_centred_looks(reference, place, LOOKS_AROUND):
            flange = Pose.from_transform(look.pose @ fit.flange_from_tool.inverse())
            with suppress(LimitError):
                joints.append(model.kinematics.solve_branch(flange, branch, near))
                spheres.append(number)
    if not joints:
        return float("inf")
    count = len(joints)
    around = LookArrays(
        joints_rad=np.array(joints),
        flanks=np.ones((count, model.joints)),
        points_mm=np.zeros((count, 3)),
        covariances_mm2=np.zeros((count, 3, 3)),
        sphere=np.array(spheres, dtype=np.intp),
    )
    return _size_mm(propagate(model.slopes(fit.values, around), fit.covariance))


def _nominal_error_mm(fit: ArmFit, looks: LookArrays) -> float:
    """Return the error of the nominal arm and head about each sphere's mean position, 3-D rms in mm."""
    nothing = np.zeros(len(fit.values))
    offsets_mm = fit.model.misses(nothing, looks)
    for number in np.unique(looks.sphere):
        here = looks.sphere == number
        offsets_mm[here] -= offsets_mm[here].mean(axis=0)
    return rms_mm(offsets_mm)


def _size_mm(covariances_mm2: Array) -> float:
    """Return the 3-D rms in mm of errors with covariances (m, 3, 3)."""
    return float(np.sqrt(np.mean(np.einsum("mii->m", covariances_mm2))))
