"""Rigid registration of paired points: transform, residuals, and predicted target error."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.error_theory import (
    DEFAULT_CONFIDENCE,
    FreGate,
    chi_square_limit,
    degrees_of_freedom,
    error_limit_mm,
    fle_from_fre_mm,
    fre_gate,
    pose_covariance,
    require_size,
    target_covariance_mm2,
    tre_principal_axes_mm,
)
from procedures.registration.errors import UNSOUND_REGISTRATION, BadParameter, CollinearPoints
from procedures.registration.points import (
    FEWEST_PAIRS,
    validate_covariances,
    validate_pairs,
    validate_targets,
)
from procedures.registration.rigid_fit import fit_rigid, fit_weighted
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform
from ronna_hw.notebook_html import table_html

COLLINEAR_REFUSED = 1e-3  # second over first singular value of the cross-covariance
COLLINEAR_WARNED = 0.05
SOUND_CONFIDENCE = 0.999  # of the gate in `caveats`: one false alarm in a thousand sound fits
THICKNESS_COUNTED = 1e-3  # third over first singular value: below it a set counts as planar
ILL_POSED_MARGIN = 0.05  # third over second singular value; this near 1, a mirrored set has no clear rotation


class Caveat(StrEnum):
    """Defect of a registration that neither its transform nor its predicted error reveals."""

    NEARLY_COLLINEAR = "nearly collinear"
    MIRRORED = "a mirror image fits better than any rotation"
    ILL_POSED = "mirrored, and two principal axes are equal: the rotation is arbitrary"
    MISFIT = "the residuals are larger than the stated covariances explain"


@dataclass(frozen=True)
class TargetError:
    """Predicted error at targets.

    `rms_mm` (m,), the radius `limit_mm` (m,) that contains the error with probability `confidence`, the
    covariance (m, 3, 3) in the physical frame, and the formula used.
    """

    rms_mm: Array
    limit_mm: Array
    confidence: float
    covariance_mm2: Array
    formula: str


@dataclass(frozen=True)
class Registration:
    """Rigid registration physical <- image, with residuals and predicted error.

    `residuals_mm` (n, 3) is measured minus mapped, in the physical frame. `chi_square` is the residual sum
    weighted by the covariances (None without). `fre_mm` is a residual, never an accuracy.
    """

    transform: RigidTransform
    fre_mm: float
    residuals_mm: Array
    image_mm: Array
    physical_mm: Array
    covariance_mm2: Array | None
    chi_square: float | None
    caveats: tuple[Caveat, ...]

    @property
    def pairs(self) -> int:
        """Number of pairs used."""
        return len(self.image_mm)

    def _repr_html_(self) -> str:
        """Return the pairs and their residuals as a notebook shows them."""
        heads = ("pair", "image_mm", "physical_mm", "residual_mm", "distance_mm")
        pairs = zip(self.image_mm, self.physical_mm, self.residuals_mm, strict=True)
        rows = [(number, *pair, float(np.linalg.norm(pair[-1]))) for number, pair in enumerate(pairs, 1)]
        caveats = "".join(f"; {one}" for one in self.caveats)
        caption = f"{self.pairs} pairs, FRE {self.fre_mm:.3f} mm: not the error at a target{caveats}"
        return table_html(heads, rows, len(rows), caption)

    @cached_property
    def leave_one_out_mm(self) -> tuple[float | None, ...]:
        """Distance of each measured position from where the other pairs predict it.

        None if the others do not determine a transform. Raises REG-006 if their fit does not converge. Costs
        as many fits as there are pairs, when it is first read.
        """
        image, physical, covariance = self.image_mm, self.physical_mm, self.covariance_mm2
        distances: list[float | None] = [None] * self.pairs
        for index in range(self.pairs) if self.pairs > FEWEST_PAIRS else ():
            keep = np.arange(self.pairs) != index
            kept = None if covariance is None else covariance[keep]
            with suppress(CollinearPoints):
                rotation, translation, _ = _fit(image[keep], physical[keep], kept)
                apart = physical[index] - rotation @ image[index] - translation
                distances[index] = float(np.linalg.norm(apart))
        return tuple(distances)

    @property
    def fle_mm(self) -> float:
        """3-D rms localization error of both spaces, from stated covariances or else from FRE by eq. 36."""
        if self.covariance_mm2 is not None:
            return math.sqrt(float(np.trace(self.covariance_mm2, axis1=1, axis2=2).mean()))
        return fle_from_fre_mm(self.fre_mm, self.pairs)

    def between(self, target: Frame, source: Frame) -> Transform:
        """Return the transform between named frames, such as `between(Frame.ROBOT, Frame.CT)`.

        Raises FRM-002 for a name that is no frame.
        """
        return Transform(target, source, self.transform)

    def require_rotation(self) -> None:
        """Raise REG-009 if the fit is mirrored or ill-posed, whatever its residuals."""
        bad = [one for one in self.caveats if one in (Caveat.MIRRORED, Caveat.ILL_POSED)]
        if bad:
            raise UNSOUND_REGISTRATION(f"the registration is not sound: {', '.join(bad)}")

    def require_sound(self) -> None:
        """Raise REG-009 if the fit is mirrored or ill-posed, REG-010 if its covariances do not explain it.

        Without covariances nothing says how large a residual may be: judge it by `gate` with a known FLE.
        """
        self.require_rotation()
        if Caveat.MISFIT in self.caveats:
            self.gate(confidence=SOUND_CONFIDENCE).require(
                "Check that the rows of both sets are in one order and in mm; leave_one_out_mm shows "
                "a fiducial that moved."
            )

    def gate(self, fle_mm: float | None = None, confidence: float = DEFAULT_CONFIDENCE) -> FreGate:
        """Judge the residual by chi-square against a known FLE in mm or, by default, the stated covariances.

        An FLE estimated from the same FRE cannot judge it: raises REG-007 when neither is given.
        """
        if fle_mm is not None:
            return fre_gate(self.fre_mm, fle_mm, self.pairs, confidence)
        if self.chi_square is None:
            action = "Give fle_mm, or register with covariance_mm2."
            raise BadParameter("the gate needs a known FLE or covariances", action=action)
        limit = chi_square_limit(degrees_of_freedom(self.pairs), confidence)
        return FreGate(self.fre_mm, self.chi_square, limit, confidence)

    def predict_tre_mm(self, points: ArrayLike, *, fle_mm: float | None = None) -> Array:
        """Predict the rms error (m,) in mm at image points (m, 3) or (3,) mm; see `predict_tre`."""
        return self.predict_tre(points, fle_mm=fle_mm).rms_mm

    def predict_tre(
        self, points: ArrayLike, *, fle_mm: float | None = None, confidence: float = DEFAULT_CONFIDENCE
    ) -> TargetError:
        """Predict the error at image points (m, 3) or (3,) in mm, with its confidence limit.

        With covariances: their propagation through the weighted fit. Without: eq. 39 with `fle_mm` (3-D rms
        of both spaces together), or with the FLE that eq. 36 estimates from FRE; the limit then also carries
        the uncertainty of that estimate. Raises REG-001, REG-007.
        """
        targets = np.asarray(self.transform.apply(validate_targets(points)), dtype=float)
        fiducials = np.asarray(self.transform.apply(self.image_mm), dtype=float)
        if fle_mm is None and self.covariance_mm2 is not None:
            pose = pose_covariance(fiducials, self.covariance_mm2, weighted=True)
            covariance = target_covariance_mm2(targets, fiducials, pose)
            rms = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
            return TargetError(
                rms, error_limit_mm(covariance, confidence), confidence, covariance, "covariance propagation"
            )
        if fle_mm is not None:
            require_size("FLE", fle_mm)
        size_mm = fle_from_fre_mm(self.fre_mm, self.pairs) if fle_mm is None else fle_mm
        isotropic = np.broadcast_to(np.eye(3) * size_mm**2 / 3.0, (self.pairs, 3, 3))
        pose = pose_covariance(fiducials, isotropic, weighted=False)
        covariance = target_covariance_mm2(targets, fiducials, pose)
        freedom = degrees_of_freedom(self.pairs) if fle_mm is None else None
        return TargetError(
            tre_principal_axes_mm(targets, fiducials, size_mm),
            error_limit_mm(covariance, confidence, freedom),
            confidence,
            covariance,
            "eq. 39, FLE given" if fle_mm is not None else "eq. 39, FLE from FRE by eq. 36",
        )


def register(
    image_mm: ArrayLike, physical_mm: ArrayLike, *, covariance_mm2: ArrayLike | None = None
) -> Registration:
    """Register paired points (n, 3) in mm, n >= 3, by a rigid transform physical <- image.

    `covariance_mm2` (n, 3, 3) is the total error of each pair in the physical frame; with it the fit is
    weighted, and `caveats` says if it does not explain the residuals. Raises REG-001 to REG-006 (all also
    ValueError): shape, NaN or unequal counts, fewer than three, collinear, duplicates nearer than 2 mm, bad
    covariance, no convergence.
    """
    image, physical = validate_pairs(image_mm, physical_mm)
    covariance = None if covariance_mm2 is None else validate_covariances(covariance_mm2, len(image))
    rotation, translation, caveats = _fit(image, physical, covariance)
    transform = RigidTransform.from_components(translation, Rotation.from_matrix(rotation))
    residual_vectors_mm = physical - np.asarray(transform.apply(image), dtype=float)
    chi_square = None
    if covariance is not None:
        weights = np.linalg.inv(covariance)
        chi_square = float(np.einsum("ni,nij,nj->", residual_vectors_mm, weights, residual_vectors_mm))
        if chi_square > chi_square_limit(degrees_of_freedom(len(image)), SOUND_CONFIDENCE):
            caveats += (Caveat.MISFIT,)
    return Registration(
        transform=transform,
        fre_mm=math.sqrt(float(np.square(residual_vectors_mm).sum(axis=1).mean())),
        residuals_mm=residual_vectors_mm,
        image_mm=image,
        physical_mm=physical,
        covariance_mm2=covariance,
        chi_square=chi_square,
        caveats=caveats,
    )


def _fit(image: Array, physical: Array, covariance: Array | None) -> tuple[Array, Array, tuple[Caveat, ...]]:
    fit = fit_rigid(image, physical)
    largest, middle, smallest = (float(value) for value in fit.spread_mm2)
    if middle <= COLLINEAR_REFUSED * largest:
        ratio = middle / largest if largest > 0.0 else 0.0
        raise CollinearPoints(
            "the points are collinear", limit=f"ratio {COLLINEAR_REFUSED:g}", got=f"{ratio:.2g}"
        )
    caveats = []
    if middle < COLLINEAR_WARNED * largest:
        caveats.append(Caveat.NEARLY_COLLINEAR)
    if bool(fit.mirrored) and smallest > THICKNESS_COUNTED * largest:
        caveats.append(Caveat.MIRRORED)
        if middle - smallest < ILL_POSED_MARGIN * middle:
            caveats.append(Caveat.ILL_POSED)
    rotation, translation = fit.rotation, fit.translation_mm
    if covariance is not None:
        rotation, translation = fit_weighted(image, physical, covariance, rotation, translation)
    return rotation, translation, tuple(caveats)
