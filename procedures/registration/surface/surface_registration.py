"""Registration of a scan to the surface in the CT, with what it knows about its own error.

Looks at spheres on screws, if there are any, are rows of the same adjustment.
The scan is settled robustly, other bodies and hair are left out, and the pose is adjusted under all
hypotheses about the misfit of the skin, and about a region of it that moved by itself (`misfit`). The error
at a target follows from the mixture: never from the sharpness of the fit alone, which counts neighbouring
points as if they were independent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from procedures.registration.error_sources import LINE, SKIN, SPHERES
from procedures.registration.points import validate_targets
from procedures.registration.rigid_fit import pose_jacobian
from procedures.registration.surface.arm_at_target import FoundArm
from procedures.registration.surface.bare_bone import open_where_bare
from procedures.registration.surface.changed_skin import ChangedSkin, likely_regions, list_regions
from procedures.registration.surface.checks import (
    SurfaceLimits,
    is_side_proven,
    require_agreement,
    require_bare_skin,
    require_coverage,
    require_determined,
    require_same_head,
    require_skin,
    require_start,
    require_still,
    share_covered,
)
from procedures.registration.surface.global_search import find_pose
from procedures.registration.surface.misfit import (
    LEAST_NOISE_MM,
    UNMODELLED,
    Adjustment,
    Misfit,
    MisfitModel,
    PoseMixture,
)
from procedures.registration.surface.prediction import SurfacePrediction, mixture_limit_mm
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.scan import SurfaceScan
from procedures.registration.surface.settling import Pose, Settled, mark_other_bodies, settle
from procedures.registration.surface.shared_errors import AtTarget, ErrorColumns, Sources
from procedures.registration.surface.spheres import (
    LookedSpheres,
    SphereAlone,
    judge_spheres,
    require_unmoved,
)
from procedures.registration.surface.starts import Start, pose_of
from procedures.registration.surface.surface import Surface, level_errors_mm
from procedures.registration.surface.thinning import merge_neighbours, thin_points
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
    other bodies and hair. `changed` skin has probably moved by itself. `coverage` is the share of the head's
    surface that was scanned. `side_proven` says whether the mirror image fits clearly
    worse: if it does not, left and right must be confirmed by another observation. Looks at spheres have
    their `sphere_residuals_mm` (m, 3), robot frame, and each sphere how it fits everything else.
    """

    robot_from_ct: Transform
    points_mm: Array
    residuals_mm: Array
    excluded: Mask
    changed: ChangedSkin | None
    coverage: float
    side_proven: bool
    centre_ct_mm: Array
    mixture: PoseMixture = field(repr=False)
    misfits: tuple[Misfit, ...] = field(repr=False)  # of the mixture's hypotheses
    gains: Array = field(repr=False)  # (c, 6, m + 3k) of the points used and of the looks at spheres
    along_mm: Array = field(repr=False)  # (m + 3k, q) their displacements by the shared errors
    sources: tuple[tuple[str, int], ...]  # of these errors by name, and their numbers of columns
    noise_mm2: Array = field(repr=False)  # (m,) of the used points, along their normals
    sphere_noise_mm2: Array = field(repr=False)  # (3k, 3k) of the looks at spheres
    sphere_residuals_mm: Array
    spheres: tuple[SphereAlone, ...]
    arm: FoundArm = field(repr=False)

    @property
    def misfit_mm(self) -> float:
        """Standard deviation of the misfit that the scan shows, rms over the hypotheses."""
        sizes_mm = np.array([one.size_mm for one in self.misfits])
        return float(np.sqrt(self.mixture.weights @ sizes_mm[self.mixture.hypothesis] ** 2))

    @property
    def misfit_length_mm(self) -> float:
        """Expected correlation length of the misfit."""
        lengths_mm = np.array([one.length_mm for one in self.misfits])
        return float(self.mixture.weights @ lengths_mm[self.mixture.hypothesis])

    @property
    def unmodelled(self) -> float:
        """Standard deviation of the skin's part of the error, relative to that of the hypotheses.

        Beside spheres the hypotheses have it.
        """
        return 1.0 if self.spheres else UNMODELLED

    @property
    def arm_at_spheres_mm(self) -> Array:
        """How far each look at a sphere (m, 3) was from where the arm says, as expected, robot frame."""
        rows = self.along_mm[len(self.along_mm) - self.sphere_residuals_mm.size :]
        return np.asarray((rows @ (self.mixture.weights @ self.arm.sizes)).reshape(-1, 3))

    def predict(self, target_ct_mm: ArrayLike, arm_at_target: Sources = ()) -> SurfacePrediction:
        """Predict the error at a target (3,) of the CT.

        `arm_at_target` are the sources that were given to the registration, with what they displace at this
        target; without them the error is that of an arm that errs nowhere. Raises REG-001, SRF-001.
        """
        slope, gains, at_target = self._at(target_ct_mm, arm_at_target)
        by_arm, by_spheres = gains @ self.along_mm, gains[:, :, len(self.noise_mm2) :]
        whole, offsets = slope @ self.mixture.covariances @ slope.T, self.mixture.shifts @ slope.T
        known_mm2 = by_spheres @ self.sphere_noise_mm2 @ np.swapaxes(by_spheres, 1, 2)
        if not arm_at_target:
            by_skin = whole - known_mm2 - by_arm @ np.swapaxes(by_arm, 1, 2)
            return SurfacePrediction(self.mixture.weights, offsets, self.unmodelled**2 * by_skin + known_mm2)
        shared_mm = _shared(at_target)
        crossed = slope @ self.gains @ self.along_mm @ shared_mm.T
        whole = whole + crossed + np.swapaxes(crossed, 1, 2) + shared_mm @ shared_mm.T
        whole = whole - self.arm.covariances_mm2(shared_mm)
        corrections = self.arm.corrections_mm(shared_mm)
        offsets = offsets + corrections - self.mixture.weights @ corrections
        by_arm = by_arm + shared_mm
        known_mm2 = known_mm2 + by_arm @ np.swapaxes(by_arm, 1, 2)
        beside_mm2 = sum(one.independent_mm2 for one in at_target)
        covariances = self.unmodelled**2 * (whole - known_mm2) + known_mm2 + beside_mm2
        return SurfacePrediction(self.mixture.weights, offsets, covariances)

    def correct(self, arm_at_target: Sources) -> tuple[Array, float]:
        """Return how far (3,) mm to send the arm beside a target for its error there, and the longest usual.

        `predict` counts with it. The limit holds 999 of 1,000.
        """
        shared = _shared(AtTarget.of(arm_at_target, self.sources))
        weights, covariances = self.mixture.weights, self.arm.covariances_mm2(shared)
        limit_mm = mixture_limit_mm(weights, np.zeros((len(weights), 3)), covariances, EXPLAINED)
        return np.asarray(weights @ self.arm.corrections_mm(shared)), limit_mm

    def split(self, target_ct_mm: ArrayLike, arm_at_target: Sources = ()) -> dict[str, float]:
        """Return the mean square error in mm2 at a target by source; the sum is that of `predict`.

        The skin has what the measurement and the arm do not explain, the spread of the hypotheses included.
        """
        _, gains, at_target = self._at(target_ct_mm, arm_at_target)
        weights = self.mixture.weights
        by_points, by_spheres = np.split(gains, [len(self.noise_mm2)], axis=2)
        shares = {LINE: float(weights @ np.sum(by_points**2 * self.noise_mm2, axis=(1, 2)))}
        if self.spheres:
            mean_mm2 = np.einsum("hij,jk,hik->h", by_spheres, self.sphere_noise_mm2, by_spheres)
            shares[SPHERES] = float(weights @ mean_mm2)
        first = 0
        for one in at_target:
            last = first + one.shared_mm.shape[1]
            columns = gains @ self.along_mm[:, first:last] + one.shared_mm
            mean_mm2 = float(weights @ np.sum(columns**2, axis=(1, 2)) + np.trace(one.independent_mm2))
            shares[one.source] = shares.get(one.source, 0.0) + mean_mm2
            first = last
        rest_mm2 = self.predict(target_ct_mm, arm_at_target).rms_mm ** 2 - sum(shares.values())
        return {SKIN: max(rest_mm2, 0.0), **shares}

    def _at(
        self, target_ct_mm: ArrayLike, arm_at_target: Sources
    ) -> tuple[Array, Array, tuple[AtTarget, ...]]:
        """Return a target's slope (3, 6), the effects of all rows (c, 3, n), and the arm's errors."""
        target = validate_targets(target_ct_mm)[0]
        slope = -self.robot_from_ct.rotation_matrix @ pose_jacobian(target, self.centre_ct_mm)
        gains = slope @ self.gains
        if not arm_at_target:
            return slope, gains, ()
        at_target = AtTarget.of(arm_at_target, self.sources)
        made_up_for = _shared(at_target) @ self.arm.gains
        return slope, gains - made_up_for, at_target


def _shared(at_target: Sequence[AtTarget]) -> Array:
    """Return the displacements (3, q) of a target by all shared errors."""
    return np.concatenate([one.shared_mm for one in at_target], axis=1)


def register_surface(
    scan: SurfaceScan,
    surface: Surface,
    start: Start | None = None,
    *,
    targets_ct_mm: ArrayLike | None = None,
    arm: Sources = (),
    spheres: LookedSpheres | None = None,
    limits: SurfaceLimits | None = None,
    find_bone: Callable[[], Surface] | None = None,
) -> SurfaceRegistration:
    """Register a scan to a surface; without a start the pose is searched by the scan alone.

    `arm` are errors that the points share, as displacements in the robot frame, with a row for each look (in
    the order of their numbers) or for each point, then for each look at the `spheres`. Without targets the
    middle of the head stands for them. `find_bone` returns the skull, for the part of the scan that lies on
    it because the scalp is open.
    Raises SRF-001 to SRF-012: a registration that is not refused may be used within its predicted error.
    """
    limits, spheres = limits or SurfaceLimits(), spheres or LookedSpheres.none()
    axes = HeadAxes.of(surface)
    targets = axes.centre_mm[None] if targets_ct_mm is None else validate_targets(targets_ct_mm)
    thin = scan.select(thin_points(scan.points_mm))
    if len(thin) < FEWEST_POINTS:
        require_coverage(0.0, len(thin), limits)
    settled, surface = _settle(thin, surface, start, limits, find_bone)
    # By all points: which of them a grid in the robot's frame has left must not decide which are merged.
    pose = settle(settled.pose, scan.points_mm, scan.view_mm, surface).pose
    merged, rows, is_hair, far = merge_neighbours(
        scan, Settled.at(pose, scan.points_mm, scan.view_mm, surface)
    )
    found = Settled.at(pose, merged.points_mm, merged.view_mm, surface)
    used = ~mark_other_bodies(found) & ~is_hair
    excluded = np.append(~used, np.ones(len(far), dtype=bool))
    require_bare_skin(excluded, limits)
    if used.sum() < FEWEST_POINTS:
        require_coverage(0.0, int(used.sum()), limits)
    coverage = require_coverage(share_covered(found.places_mm[used], surface, axes), int(used.sum()), limits)
    side_proven = is_side_proven(found, used, merged.points_mm, merged.view_mm, surface, axes)
    columns = ErrorColumns.of(arm, scan, rows, len(spheres.numbers))
    adjusted = _Adjusted.of(found, used, merged, surface, columns, spheres, axes)
    require_agreement(adjusted.changed, limits)
    require_unmoved(adjusted.spheres)
    found = adjusted.found
    require_start(found.pose, start, axes)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = found.pose.rotation, found.pose.translation_mm
    ct_from_robot = Transform(Frame.CT, Frame.ROBOT, RigidTransform.from_matrix(matrix))
    beside = Settled.at(found.pose, scan.points_mm[far], scan.view_mm[far], surface)
    changed = adjusted.changed
    if changed is not None:
        changed = replace(changed, points=np.append(changed.points, np.zeros(len(far), dtype=bool)))
    registration = SurfaceRegistration(
        robot_from_ct=ct_from_robot.inverse(),
        points_mm=np.vstack([merged.points_mm, scan.points_mm[far]]),
        residuals_mm=np.append(found.distances_mm, beside.distances_mm),
        excluded=excluded,
        changed=changed,
        coverage=coverage,
        side_proven=side_proven,
        centre_ct_mm=adjusted.centre_mm,
        mixture=adjusted.mixture,
        misfits=adjusted.misfits,
        gains=adjusted.gains,
        along_mm=adjusted.along_mm,
        sources=columns.sources,
        noise_mm2=adjusted.noise_mm2,
        sphere_noise_mm2=spheres.covariance_mm2,
        sphere_residuals_mm=spheres.residuals_mm(found.pose).reshape(-1, 3),
        spheres=adjusted.spheres,
        arm=adjusted.arm,
    )
    for target in targets:
        predicted = registration.predict(target)
        in_ct = found.pose.rotation @ predicted.covariance_mm2 @ found.pose.rotation.T
        require_determined(predicted.limit_mm(), in_ct, target, limits)
    return registration


def _settle(
    thin: SurfaceScan,
    surface: Surface,
    start: Start | None,
    limits: SurfaceLimits,
    find_bone: Callable[[], Surface] | None,
) -> tuple[Settled, Surface]:
    """Settle the scan on the surface, which bare bone may be a part of. Raises SRF-002, 004, 005, 010.

    A start from which it does not settle is not trusted: the search then says whether it was wrong.
    """
    points, view, same_head_mm = thin.points_mm, thin.view_mm, limits.largest_residual_mm

    def settle_from(pose: Pose) -> tuple[Settled, Surface]:
        on_skin = settle(pose, points, view, surface)
        if find_bone is None:
            return on_skin, surface
        return open_where_bare(on_skin, pose, points, view, surface, find_bone)

    found, opened = (None, surface) if start is None else settle_from(pose_of(start.robot_from_ct))
    if found is None or found.sigma_mm > same_head_mm:
        found, opened = settle_from(find_pose(points, view, surface, same_head_mm).pose)
    require_same_head(found, limits)
    is_other = mark_other_bodies(found)
    require_skin(is_other, limits)
    return settle(found.pose, points, view, opened, ~is_other), opened


@dataclass(frozen=True, eq=False)
class _Adjusted:
    """Pose at the mean of all hypotheses, the mixture about it, and what it says of skin and spheres."""

    found: Settled
    centre_mm: Array
    mixture: PoseMixture
    misfits: tuple[Misfit, ...]
    gains: Array
    along_mm: Array
    noise_mm2: Array
    changed: ChangedSkin | None
    spheres: tuple[SphereAlone, ...]
    arm: FoundArm

    @classmethod
    def of(
        cls,
        found: Settled,
        used: Mask,
        merged: SurfaceScan,
        surface: Surface,
        columns: ErrorColumns,
        spheres: LookedSpheres,
        axes: HeadAxes,
    ) -> Self:
        """Adjust the pose of the used points, and of spheres, from where they settled. Raises SRF-007.

        The slopes stay those of the first pose, with which the shared errors were projected: otherwise a turn
        of the normals by a hundredth would tell the one from the other.
        """
        directions = found.directions
        noise = merged.noise_along_mm2(directions)[used]
        points, places, towards = merged.points_mm[used], found.places_mm[used], directions[used]
        centre, along = places.mean(axis=0), columns.along(directions)[used]
        of_all = found.jacobian(centre)
        jacobian = of_all[used]
        level = level_errors_mm(found.normals[used], surface.voxel_mm)
        model = MisfitModel.of(points, towards, noise, along, level)
        require_still(model, jacobian, found.distances_mm[used], merged.look[used])  # by the scan alone
        if len(spheres.numbers):
            along = np.vstack([along, columns.of_spheres()])
            jacobian = np.vstack([jacobian, spheres.jacobian(found.pose, centre)])
            model = MisfitModel.of(points, towards, noise, along, level, known_mm2=spheres.covariance_mm2)
        listed = list_regions(places, found.normals[used], axes)
        residuals = np.append(found.distances_mm[used], spheres.residuals_mm(found.pose))
        regions = likely_regions(model, jacobian, residuals, listed)
        adjustment = Adjustment.of(model, jacobian, regions, listed.shape[1])
        for _ in range(MOST_STEPS):
            residuals = np.append(found.distances_mm[used], spheres.residuals_mm(found.pose))
            mixture = adjustment.step(residuals)
            mean = mixture.mean
            if np.abs(mean).max() < STILL:
                break
            expected_mm = found.distances_mm + of_all @ mean
            after = Settled.at(found.pose.moved(mean, centre), merged.points_mm, merged.view_mm, surface)
            found = after.on_the_same_parts(expected_mm)
        changed = ChangedSkin.of(mixture, regions, found, used, axes)
        likely = mixture.likely()
        return cls(
            found,
            centre,
            replace(likely, shifts=likely.shifts - mean),
            model.misfits,
            adjustment.gains(likely),
            along,
            noise + LEAST_NOISE_MM**2,
            changed,
            judge_spheres(model, jacobian, residuals, spheres),
            FoundArm.of(adjustment, likely, residuals, along),
        )
