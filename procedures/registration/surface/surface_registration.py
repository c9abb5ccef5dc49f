"""Registration of a scan to the surface in the CT, with what it knows about its own error.

Looks at spheres on screws, if there are any, are rows of the same adjustment.
The scan is settled robustly, other bodies and changed skin are excluded, and the pose is adjusted under all
hypotheses about the misfit of the skin (`misfit`). The error at a target follows from the mixture: never from
the sharpness of the fit alone, which counts neighbouring points as if they were independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from procedures.registration.error_sources import LINE, SKIN, SPHERES
from procedures.registration.points import validate_targets
from procedures.registration.rigid_fit import pose_jacobian
from procedures.registration.surface.arm_at_target import FoundArm
from procedures.registration.surface.checks import (
    CHANGED_MM,
    ChangedSkin,
    SurfaceLimits,
    is_side_proven,
    list_doubted,
    require_agreement,
    require_coverage,
    require_determined,
    require_same_head,
    require_skin,
    require_start,
    require_still,
    share_covered,
    weigh_regions,
)
from procedures.registration.surface.evidence import SCOUTS
from procedures.registration.surface.misfit import LEAST_NOISE_MM, MISFITS, Misfit, MisfitModel, PoseMixture
from procedures.registration.surface.prediction import SurfacePrediction, mixture_limit_mm
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.scan import SurfaceScan
from procedures.registration.surface.settling import Settled, mark_other_bodies, settle
from procedures.registration.surface.shared_errors import ErrorColumns, Sources, at_target
from procedures.registration.surface.spheres import (
    LookedSpheres,
    SphereAlone,
    judge_spheres,
    require_unmoved,
)
from procedures.registration.surface.starts import Start, find_pose, pose_of
from procedures.registration.surface.surface import Surface
from procedures.registration.surface.thinning import thin_points
from ronna_hw.arrays import Array, Mask
from ronna_hw.frames import Frame, Transform

EXPLAINED = 0.999  # of the corrections for the arm, by its errors as stated
MOST_STEPS = 12
STILL = 1e-5  # mm and rad: a smaller step changes nothing
FEWEST_POINTS = 30  # of a scan after thinning: five for each unknown


@dataclass(frozen=True, eq=False)
class SurfaceRegistration:
    """Pose robot <- CT by a surface, and its error.

    `points_mm` are those of the thinned scan, `residuals_mm` their distances to the surface. `excluded` marks
    other bodies and `changed` skin; of `doubted` skin the shift is unknown in the adjustment. `coverage` is
    the share of the head's surface that was scanned. `side_proven` says whether the mirror image fits clearly
    worse: if it does not, left and right must be confirmed by another observation. Looks at spheres have
    their `sphere_residuals_mm` (m, 3), robot frame, and each sphere how it fits everything else.
    """

    robot_from_ct: Transform
    points_mm: Array
    residuals_mm: Array
    excluded: Mask
    changed: tuple[ChangedSkin, ...]
    doubted: tuple[ChangedSkin, ...]
    coverage: float
    side_proven: bool
    centre_ct_mm: Array
    mixture: PoseMixture = field(repr=False)
    along_mm: Array = field(repr=False)  # (m, k) displacement of the used points by the shared errors
    noise_mm2: Array = field(repr=False)  # (m,) of the used points, along their normals
    sphere_noise_mm2: Array = field(repr=False)  # (3k, 3k) of the looks at spheres
    sphere_residuals_mm: Array
    spheres: tuple[SphereAlone, ...]
    arm: FoundArm = field(repr=False)

    @property
    def misfit_mm(self) -> float:
        """Standard deviation of the misfit that the scan shows, rms over the hypotheses."""
        return float(np.sqrt(self.mixture.weights @ [one.size_mm**2 for one in MISFITS]))

    @property
    def misfit_length_mm(self) -> float:
        """Expected correlation length of the misfit."""
        return float(self.mixture.weights @ [one.length_mm for one in MISFITS])

    @property
    def arm_at_spheres_mm(self) -> Array:
        """How far each look at a sphere (m, 3) was from where the arm says, as expected, robot frame."""
        rows = self.along_mm[len(self.along_mm) - self.sphere_residuals_mm.size :]
        return np.asarray((rows @ (self.mixture.weights @ self.arm.sizes)).reshape(-1, 3))

    def predict(self, target_ct_mm: ArrayLike, arm_at_target: Sources = ()) -> SurfacePrediction:
        """Predict the error at a target (3,) of the CT.

        `arm_at_target` are the sources that were given to the registration, with what they displace at this
        target; without them the error is that of the registration alone. Raises REG-001.
        """
        target = validate_targets(target_ct_mm)[0]
        slope = -self.robot_from_ct.rotation_matrix @ pose_jacobian(target, self.centre_ct_mm)
        covariances = slope @ self.mixture.covariances @ slope.T
        if arm_at_target:
            shared, independent_mm2 = at_target(arm_at_target)
            crossed = slope @ self.mixture.gains @ self.along_mm @ shared.T
            covariances = (
                covariances + crossed + np.swapaxes(crossed, 1, 2) + shared @ shared.T + independent_mm2
            )
        offsets = self.mixture.shifts @ slope.T
        if arm_at_target and self.spheres:
            covariances = covariances - self.arm.covariances_mm2(shared)
            corrections = self.arm.corrections_mm(shared)
            offsets = offsets + corrections - self.mixture.weights @ corrections
        return SurfacePrediction(self.mixture.weights, offsets, covariances)

    def correct(self, arm_at_target: Sources) -> tuple[Array, float]:
        """Return how far (3,) mm to send the arm beside a target for its error there, and the longest usual.

        Zero without spheres: `predict` counts with it. The limit holds 999 of 1,000.
        """
        shared, _ = at_target(arm_at_target)
        if not self.spheres:
            return np.zeros(3), 0.0
        weights, covariances = self.mixture.weights, self.arm.covariances_mm2(shared)
        limit_mm = mixture_limit_mm(weights, np.zeros((len(weights), 3)), covariances, EXPLAINED)
        return np.asarray(weights @ self.arm.corrections_mm(shared)), limit_mm

    def split(self, target_ct_mm: ArrayLike, arm_at_target: Sources = ()) -> dict[str, float]:
        """Return the mean square error in mm2 at a target by source; the sum is that of `predict`.

        The skin has what the measurement and the arm do not explain, the spread of the hypotheses included.
        """
        target = validate_targets(target_ct_mm)[0]
        slope = -self.robot_from_ct.rotation_matrix @ pose_jacobian(target, self.centre_ct_mm)
        gains, weights = slope @ self.mixture.gains, self.mixture.weights  # (h, 3, rows)
        if arm_at_target and self.spheres:  # what is made up for
            gains = gains - at_target(arm_at_target)[0] @ self.arm.gains
        by_points, by_spheres = np.split(gains, [len(self.noise_mm2)], axis=2)
        shares = {LINE: float(weights @ np.sum(by_points**2 * self.noise_mm2, axis=(1, 2)))}
        if self.spheres:
            mean_mm2 = np.einsum("hij,jk,hik->h", by_spheres, self.sphere_noise_mm2, by_spheres)
            shares[SPHERES] = float(weights @ mean_mm2)
        first = 0
        for one in arm_at_target:
            shared, independent_mm2 = at_target([one])
            columns = gains @ self.along_mm[:, first : first + shared.shape[1]] + shared
            first += shared.shape[1]
            mean_mm2 = float(weights @ np.sum(columns**2, axis=(1, 2)) + np.trace(independent_mm2))
            shares[one.source] = shares.get(one.source, 0.0) + mean_mm2
        rest_mm2 = self.predict(target, arm_at_target).rms_mm ** 2 - sum(shares.values())
        return {SKIN: max(rest_mm2, 0.0), **shares}


def register_surface(
    scan: SurfaceScan,
    surface: Surface,
    start: Start | None = None,
    *,
    targets_ct_mm: ArrayLike | None = None,
    arm: Sources = (),
    spheres: LookedSpheres | None = None,
    limits: SurfaceLimits | None = None,
) -> SurfaceRegistration:
    """Register a scan to a surface; without a start the pose is searched by the scan alone.

    `arm` are errors that the points share, as displacements in the robot frame, with a row for each look (in
    the order of their numbers) or for each point, then for each look at the `spheres`. The skin is judged by
    the scan alone. Without targets the middle of the head stands for them.
    Raises SRF-001 to SRF-012: a registration that is not refused may be used within its predicted error.
    """
    limits, spheres = limits or SurfaceLimits(), spheres or LookedSpheres.none()
    axes = HeadAxes.of(surface)
    targets = axes.centre_mm[None] if targets_ct_mm is None else validate_targets(targets_ct_mm)
    rows, _ = thin_points(scan.points_mm)
    thin = scan.select(rows)
    columns = ErrorColumns.of(arm, scan, rows, len(spheres.numbers))
    if len(thin) < FEWEST_POINTS:
        require_coverage(0.0, len(thin), limits)
    found = _settle(thin, surface, start, limits)
    used = ~mark_other_bodies(found)
    side_proven = is_side_proven(found, used, thin.points_mm, thin.view_mm, surface, axes)
    used, changed, doubted = _judge_skin(found, used, thin, columns, axes, limits)
    coverage = require_coverage(share_covered(found.places_mm[used], surface, axes), int(used.sum()), limits)
    found, centre, mixture, along, judged, of_arm = _adjust(
        found, used, thin, surface, columns, doubted, spheres
    )
    require_unmoved(judged)
    require_start(found.pose, start, axes)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = found.pose.rotation, found.pose.translation_mm
    ct_from_robot = Transform(Frame.CT, Frame.ROBOT, RigidTransform.from_matrix(matrix))
    registration = SurfaceRegistration(
        ct_from_robot.inverse(),
        thin.points_mm,
        found.distances_mm,
        ~used,
        changed,
        doubted,
        coverage,
        side_proven,
        centre,
        mixture,
        along,
        _noise_mm2(found, thin)[used] + LEAST_NOISE_MM**2,
        spheres.covariance_mm2,
        spheres.residuals_mm(found.pose).reshape(-1, 3),
        judged,
        of_arm,
    )
    for target in targets:
        predicted = registration.predict(target)
        in_ct = found.pose.rotation @ predicted.covariance_mm2 @ found.pose.rotation.T
        require_determined(predicted.limit_mm(), in_ct, target, limits)
    return registration


def _settle(thin: SurfaceScan, surface: Surface, start: Start | None, limits: SurfaceLimits) -> Settled:
    """Settle the scan on the surface. Raises SRF-002, 004, 005, 010.

    A start from which it does not settle is not trusted: the search then says whether it was wrong.
    """
    points, view, same_head_mm = thin.points_mm, thin.view_mm, limits.largest_residual_mm
    found = None if start is None else settle(pose_of(start), points, view, surface)
    if found is None or found.sigma_mm > same_head_mm:
        found = settle(find_pose(points, view, surface, same_head_mm).pose, points, view, surface)
    require_same_head(found, limits)
    is_other = mark_other_bodies(found)
    require_skin(is_other, limits)
    return settle(found.pose, points, view, surface, ~is_other)


def _judge_skin(
    found: Settled,
    used: Mask,
    thin: SurfaceScan,
    columns: ErrorColumns,
    axes: HeadAxes,
    limits: SurfaceLimits,
) -> tuple[Mask, tuple[ChangedSkin, ...], tuple[ChangedSkin, ...]]:
    """Return the points whose skin did not change, and the regions that changed, and that may have.

    Raises SRF-007, SRF-008.
    """
    changed: list[ChangedSkin] = []
    while True:
        model, jacobian, _ = _model(found, used, thin, columns, SCOUTS)  # not by spheres: judged later
        if not changed:
            require_still(model, jacobian, found.distances_mm[used], thin.look[used])
        regions = weigh_regions(model, jacobian, found, used, axes)
        clear = [one for one in regions if one.is_clear]
        if not clear:
            return used, tuple(changed), tuple(list_doubted(regions))
        changed.append(clear[0])
        require_agreement(changed, limits)
        used = used & ~clear[0].points


def _model(
    found: Settled,
    used: Mask,
    thin: SurfaceScan,
    columns: ErrorColumns,
    misfits: Sequence[Misfit],
    doubted: Sequence[ChangedSkin] = (),
    spheres: LookedSpheres | None = None,
) -> tuple[MisfitModel, Array, Array]:
    """Return the model of the used points and of spheres, their Jacobian, and the shared errors along it."""
    spheres = spheres or LookedSpheres.none()
    directions = found.normals @ found.pose.rotation  # in the robot frame
    noise = _noise_mm2(found, thin)[used]
    along, centre = columns.along(directions)[used], found.places_mm[used].mean(axis=0)
    unknown = [CHANGED_MM * one.points[used].astype(float) for one in doubted]
    shared, jacobian = np.column_stack([along, *unknown]), found.jacobian(centre)[used]
    if not len(spheres.numbers):
        return MisfitModel.of(thin.points_mm[used], noise, shared, misfits), jacobian, along
    of_spheres = np.pad(columns.of_spheres(), ((0, 0), (0, len(unknown))))
    model = MisfitModel.of(
        thin.points_mm[used],
        noise,
        np.vstack([shared, of_spheres]),
        misfits,
        known_mm2=spheres.covariance_mm2,
    )
    jacobian = np.vstack([jacobian, spheres.jacobian(found.pose, centre)])
    return model, jacobian, np.vstack([along, columns.of_spheres()])


def _noise_mm2(found: Settled, thin: SurfaceScan) -> Array:
    directions = found.normals @ found.pose.rotation  # in the robot frame
    return np.asarray(np.einsum("ni,nij,nj->n", directions, thin.covariance_mm2, directions))


def _adjust(
    found: Settled,
    used: Mask,
    thin: SurfaceScan,
    surface: Surface,
    columns: ErrorColumns,
    doubted: Sequence[ChangedSkin],
    spheres: LookedSpheres,
) -> tuple[Settled, Array, PoseMixture, Array, tuple[SphereAlone, ...], FoundArm]:
    """Step to the mean of all hypotheses; return the pose, its centre, and the mixture about it.

    The slopes stay those of the first pose, with which the shared errors were projected: otherwise a turn of
    the normals by a hundredth would tell the one from the other.
    """
    model, jacobian, along = _model(found, used, thin, columns, MISFITS, doubted, spheres)
    centre = found.places_mm[used].mean(axis=0)
    for _ in range(MOST_STEPS):
        residuals = np.append(found.distances_mm[used], spheres.residuals_mm(found.pose))
        mixture = model.adjust(jacobian, residuals)
        mean = mixture.mean
        if np.abs(mean).max() < STILL:
            break
        found = Settled.at(found.pose.moved(mean, centre), thin.points_mm, thin.view_mm, surface)
    judged = judge_spheres(model, jacobian, residuals, spheres)
    of_arm = FoundArm.of(model, jacobian, residuals, along)
    return found, centre, replace(mixture, shifts=mixture.shifts - mean), along, judged, of_arm
