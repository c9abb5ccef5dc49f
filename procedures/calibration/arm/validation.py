"""Validates an identified arm: on held-out measurements, and by what the measurements reveal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from procedures.calibration.arm.error_model import BACKLASH
from procedures.calibration.arm.identification import ArmFit, whitening_of
from procedures.calibration.arm.looks import LookArrays
from procedures.calibration.errors import DoesNotFit, Unobservable
from procedures.calibration.pose_set import centred_looks
from procedures.calibration.sufficiency import require_count
from ronna_hw.arm.pose import Pose
from ronna_hw.errors import LimitError
from ronna_hw.text import beyond, side_by_side

Array = NDArray[np.float64]

LEAST_VALIDATION = 12
ACCEPTED = 1e-4  # probability of rejecting a good calibration
LARGEST_ERROR_MM = 0.10  # of the model around a sphere: twice that of a good calibration
LOOKS_AROUND = 24  # poses around each sphere, as they are usually planned
LEAST_LEARNT = 0.5  # of a joint's backlash: 0.02 to 0.07 is usual
MODEL_SHARE = 0.25  # of the predicted variance: harmonics beyond the second, flexible links


@dataclass(frozen=True)
class ArmValidation:
    """`misses_mm` (m, 3) of held-out measurements; the rest in mm, 3-D rms.

    `before_mm` is the nominal arm's error there, `predicted_mm` the error expected from the model's
    covariance and the random error, `model_mm` the model's part of it.
    """

    misses_mm: Array
    before_mm: float
    error_mm: float
    predicted_mm: float
    model_mm: float


def validate(fit: ArmFit, looks: LookArrays) -> ArmValidation:
    """Judge a fit by held-out measurements. Raises CAL-002, CAL-004, CAL-011."""
    count = len(looks.joints_rad)
    require_count(count, LEAST_VALIDATION, "too few measurements to validate the arm")
    _require_both_sides(fit)
    model, rotations = fit.model, fit.model.rotations(looks)
    misses, slopes = model.misses(fit.values, looks), model.slopes(fit.values, looks)
    own = slopes @ fit.covariance @ slopes.transpose(0, 2, 1)
    random = rotations @ looks.covariances_mm2 @ rotations.transpose(0, 2, 1) + fit.scatter_mm**2 * np.eye(3)
    model_mm, around_mm = _size_mm(own), _around_spheres_mm(fit, looks)
    if around_mm > LARGEST_ERROR_MM:
        worst = np.argsort(fit.learnt)[::-1][:3]
        raise Unobservable(
            "the measurements do not determine enough of the arm: least of all "
            + ", ".join(model.names[number] for number in worst),
            limit=f"{LARGEST_ERROR_MM:g} mm in all orientations around the spheres",
            got=f"{beyond(around_mm, LARGEST_ERROR_MM, 2)} mm",
        )
    whitened = np.einsum("mij,mj->mi", whitening_of(own + random, 0.0), misses)
    statistic, limit = float(np.sum(whitened**2)), float(chdtri(3 * count, ACCEPTED)) * (1.0 + MODEL_SHARE)
    if statistic > limit:
        got, refused_from = side_by_side(statistic, limit, 0)
        raise DoesNotFit(
            "the identified arm does not agree with the measurements kept for validation",
            limit=f"chi-square {refused_from}",
            got=f"{got}: {_rms(misses):.3f} mm",
        )
    return ArmValidation(
        misses_mm=misses,
        before_mm=_before(fit, looks),
        error_mm=_rms(misses),
        predicted_mm=_size_mm(own + random),
        model_mm=model_mm,
    )


def _require_both_sides(fit: ArmFit) -> None:
    """The backlash of a joint that always arrived from one side shows in no measurement, held out or not."""
    unknown = [
        name
        for name, share in zip(fit.model.names, fit.learnt.tolist(), strict=True)
        if name.endswith(BACKLASH) and share > LEAST_LEARNT
    ]
    if unknown:
        raise Unobservable(
            f"the measurements do not determine the {', '.join(unknown)}: these joints "
            "arrived from one side only",
            limit=f"{LEAST_LEARNT:g} of the prior uncertainty",
            got="all of it",
        )


def _around_spheres_mm(fit: ArmFit, looks: LookArrays) -> float:
    """What the fit leaves unknown in every usual orientation, whether or not one like it was measured.

    Held-out measurements are where the others are: of an arm measured in one orientation they say nothing.
    """
    model, near = fit.model, looks.joints_rad[0]
    reference = Rotation.from_matrix(model.rotations(looks)).mean()
    spheres_mm = fit.values[model.size :].reshape(-1, 3)
    poses = [
        (number, look.pose @ fit.flange_from_tool.inverse())
        for number, place in enumerate(spheres_mm)
        for look in centred_looks(reference, place, LOOKS_AROUND)
    ]
    branch, joints, spheres = model.kinematics.branch_of(near), [], []
    for number, pose in poses:
        try:
            joints.append(model.kinematics.solve_branch(Pose.from_transform(pose), branch, near))
        except LimitError:
            continue
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
    slopes = model.slopes(fit.values, around)
    return _size_mm(slopes @ fit.covariance @ slopes.transpose(0, 2, 1))


def _before(fit: ArmFit, looks: LookArrays) -> float:
    """Error of the nominal arm and head, relative to the centroid of each sphere's measurements."""
    nothing = np.zeros(len(fit.values))
    seen = fit.model.misses(nothing, looks)
    for number in np.unique(looks.sphere):
        here = looks.sphere == number
        seen[here] -= seen[here].mean(axis=0)
    return _rms(seen)


def _size_mm(covariances_mm2: Array) -> float:
    """3-D rms of errors with covariances (m, 3, 3)."""
    return float(np.sqrt(np.mean(np.einsum("mii->m", covariances_mm2))))


def _rms(misses: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(misses**2, axis=1))))
