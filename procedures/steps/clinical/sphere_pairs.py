"""Spheres of CT and robot that a registration is fitted to, with every error of theirs that is known.

Two ways from looks to a registration: each look at a sphere of its own, as the nominal arm reports it; or all
looks of the case in one adjustment with the errors of the arm (strategy `learning`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, Self

import numpy as np

from procedures.engine.context import StepContext
from procedures.registration import Registration, register
from procedures.registration.arm_hypotheses import Source, at_looks, covariance_of, share_by_sphere
from procedures.registration.arm_learning import ArmLearning, LearnedTarget, Looks
from procedures.registration.displaced_spheres import Group
from procedures.registration.error_sources import CT, OF_SPHERES, REPEATABILITY, SEATING, STEREO
from procedures.registration.error_theory import FreGate, chi_square_limit
from procedures.registration.errors import CollinearPoints
from procedures.registration.look_checks import CheckedLooks, PassingDisplacements
from procedures.registration.moved_together import MovedTogether
from procedures.registration.points import FEWEST_PAIRS
from procedures.registration.rigid_fit import fit_rigid
from procedures.registration.target_prediction import (
    AllowedErrors,
    IndependentErrors,
    SharedErrors,
    UnnoticedPoint,
    check_residuals,
    predict_target_error,
)
from procedures.registration.tracker_view import TrackerView
from procedures.room.model import FIELD_MM
from procedures.room.sighting import expect_spheres
from procedures.steps.clinical import error_budget
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.path_check import CheckedPaths, LocalizationPose
from procedures.steps.clinical.results import LearnedArm, Relocalization
from procedures.steps.clinical.sphere_checks import SphereCheck, check_looks, check_residual
from procedures.strategies.catalogue import find_strategy
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import arm_error_mm

NO_SHIFT = np.zeros(3)
# Of the residual without a sphere that is left out: it must explain the disagreement, not only lessen it.
# Safety against two spheres that have moved (U).
LEFT_OUT_CONFIDENCE = 0.95


class Pairs(Protocol):
    """Spheres of CT and robot, their errors, and the registration by them."""

    @property
    def fiducials(self) -> tuple[int, ...]:
        """CT index of each sphere used."""
        ...

    @property
    def looked(self) -> LookedPairs:
        """Looks as the nominal arm reports them, several at one sphere if the arm is learned."""
        ...

    @property
    def fit(self) -> Registration:
        """Registration by these pairs, one pair for each sphere."""
        ...

    @property
    def checks(self) -> tuple[SphereCheck, ...]:
        """Checks whether the spheres agree, by all errors that are known."""
        ...

    def without(self, place: int) -> Pairs:
        """Return the pairs without the sphere at this place of `fiducials`."""
        ...

    def find_moved(self) -> tuple[Group, ...]:
        """Return the places of spheres, alone or two alike, that may have moved, most likely first.

        Without one that is alone the others agree.
        """
        ...

    def find_unnoticed(self, tip_mm: Array, sources: Sequence[Source]) -> UnnoticedPoint:
        """Find the sphere whose displacement could move a target (3,) mm furthest while the gate passes."""
        ...

    def predict(self, tip_mm: Array, sources: Sequence[Source]) -> LearnedTarget:
        """Predict a target (3,) mm, robot frame by `fit`, from all sources of error at the looks."""
        ...

    def learned(self, corrections: Mapping[str, LearnedTarget]) -> LearnedArm | None:
        """Return what was learned of the arm, with the correction of each target."""
        ...


def pairs_of(context: StepContext) -> Pairs:
    """Return the pairs of this localization, by the case's strategy."""
    looked = LookedPairs.of(context)
    if not find_strategy(context.result(CheckedPaths).strategy).learns_arm:
        return looked
    errors = error_budget.errors_at_looks(context, looked.looks, looked.physical_mm)
    return LearnedPairs(looked, tuple(errors))


def _seen_by_tracker(context: StepContext, fiducials: Sequence[int]) -> tuple[Array, Array]:
    """Return where the tracker saw spheres (n,), mm in the robot frame, and covariances (n, 3, 3).

    Its smooth error counts as if neighbours did not share it: what they share would show less.
    """
    room, of_ct = context.result(GlobalLocalization), dict(context.result(Correspondence).pairs)
    seen_mm = room.points_mm[[of_ct[one] for one in fiducials]]
    rotation = room.robot_from_tracker.transform.rotation_matrix
    own_mm2 = expect_spheres(seen_mm, room.frames).covariances_mm2 + np.diag(FIELD_MM**2)
    return seen_mm, rotation @ own_mm2 @ rotation.T


@dataclass(frozen=True)
class LookedPairs:
    """One look at each sphere, with covariances in the frame of the room."""

    fiducials: tuple[int, ...]
    looks: tuple[LocalizationPose, ...]
    image_mm: Array
    physical_mm: Array  # as the nominal arm reports the look, robot frame
    ct_mm2: Array
    seating_mm2: Array
    stereo_mm2: Array
    sides_mm2: Array  # of backlashes, where the strategy does not control them
    tracker_mm: Array  # as the tracker saw the sphere
    tracker_mm2: Array
    arm_mm: float  # the arm's sigma per axis
    scan: SharedErrors  # the CT as a whole
    allowed: AllowedErrors  # by the gate

    @classmethod
    def of(cls, context: StepContext) -> Self:
        """Pair every look of this localization with its sphere in the CT."""
        localization, fine = context.result(LocalizedFiducials), context.result(Relocalization)
        rotation = context.result(Correspondence).robot_from_ct.transform.rotation_matrix
        fiducials = list(fine.fiducials)
        ct = np.array([localization.markers[index].covariance_mm2 for index in fiducials])
        paths = context.result(CheckedPaths)
        all_looks = paths.looks_for(context.key.trajectory)
        axes = fine.axes or [all_looks[0][0]] * len(fiducials)  # one axis only
        planned = {(axis, one.fiducial): one for axis, one in all_looks}
        looks = tuple(planned[of] for of in zip(axes, fiducials, strict=True))
        settings = context.setting.settings
        image_mm, count = localization.centres_mm[fiducials], len(fiducials)
        ct_mm2, stereo_mm2 = rotation @ ct @ rotation.T, np.array(fine.covariances_mm2)
        seating_mm = localization.seating_mm(settings.seating_error_mm)
        seating_mm2 = np.tile(np.eye(3) * seating_mm**2, (count, 1, 1))
        sides_mm2 = error_budget.unknown_sides_mm2(context, looks, fine.points_mm)
        scan = localization.scan_errors(image_mm, image_mm.mean(axis=0), rotation)
        tracker_mm, tracker_mm2 = _seen_by_tracker(context, fiducials)
        return cls(
            fiducials=fine.fiducials,
            looks=looks,
            image_mm=image_mm,
            physical_mm=fine.points_mm,
            ct_mm2=ct_mm2,
            seating_mm2=seating_mm2,
            stereo_mm2=stereo_mm2,
            sides_mm2=sides_mm2,
            tracker_mm=tracker_mm,
            tracker_mm2=tracker_mm2,
            arm_mm=arm_error_mm(settings, context.workcell.calibrations.arm),
            scan=scan,
            allowed=error_budget.allowed_errors(
                context, looks, fine.points_mm, ct_mm2 + seating_mm2 + stereo_mm2 + sides_mm2, scan
            ),
        )

    @property
    def looked(self) -> Self:
        """The pairs themselves."""
        return self

    @property
    def measured_mm2(self) -> Array:
        """Covariance (n, 3, 3) of everything but the arm."""
        return self.ct_mm2 + self.seating_mm2 + self.stereo_mm2 + self.sides_mm2

    @cached_property
    def fit(self) -> Registration:
        return register(
            self.image_mm,
            self.physical_mm,
            covariance_mm2=self.measured_mm2 + error_budget.arm_covariance_mm2(self.arm_mm),
        )

    @property
    def gate(self) -> FreGate:
        """Residual against all errors that are known."""
        return error_budget.residual_gate(self.image_mm, self.physical_mm, self.allowed)

    @property
    def checks(self) -> tuple[SphereCheck, ...]:
        return (check_residual(self.gate),)

    def without(self, place: int) -> Self:
        return self.at([row for row in range(len(self.looks)) if row != place])

    def at(self, rows: Sequence[int]) -> Self:
        """Return the pairs at these places."""
        kept = list(rows)
        return replace(
            self,
            fiducials=tuple(self.fiducials[row] for row in rows),
            looks=tuple(self.looks[row] for row in rows),
            image_mm=self.image_mm[kept],
            physical_mm=self.physical_mm[kept],
            ct_mm2=self.ct_mm2[kept],
            seating_mm2=self.seating_mm2[kept],
            stereo_mm2=self.stereo_mm2[kept],
            sides_mm2=self.sides_mm2[kept],
            tracker_mm=self.tracker_mm[kept],
            tracker_mm2=self.tracker_mm2[kept],
            scan=replace(self.scan, at_spheres_mm=self.scan.at_spheres_mm[kept]),
            allowed=self.allowed[kept],
        )

    def find_moved(self) -> tuple[Group, ...]:
        moved = error_budget.find_moved_spheres(self.image_mm, self.physical_mm, self.allowed)
        return tuple((place,) for place in moved)

    def find_unnoticed(self, tip_mm: Array, sources: Sequence[Source]) -> UnnoticedPoint:
        return error_budget.find_undetected_sphere(self.fit, tip_mm, self.gate, self.allowed)

    def predict(self, tip_mm: Array, sources: Sequence[Source]) -> LearnedTarget:
        fit = self.fit
        residual = check_residuals(fit.residuals_mm, fit.physical_mm - fit.residuals_mm, sources)
        weights = None if fit.covariance_mm2 is None else np.linalg.inv(fit.covariance_mm2)
        predicted = predict_target_error(fit.physical_mm, tip_mm, sources, weights, residual)
        return LearnedTarget(NO_SHIFT, predicted, limit_mm=0.0)

    def learned(self, corrections: Mapping[str, LearnedTarget]) -> None:
        """Nothing is learned from one look at each sphere."""


@dataclass(frozen=True)
class LearnedPairs:
    """All looks of a case, in one adjustment with the errors of the arm at them."""

    looked: LookedPairs
    errors: tuple[Source, ...]  # of the arm

    @cached_property
    def fiducials(self) -> tuple[int, ...]:
        return tuple(sorted(set(self.looked.fiducials)))

    @cached_property
    def _coarse(self) -> ArmLearning:
        """Adjustment from the plain fit of all looks, an arm's errors away from the pose."""
        fit = fit_rigid(self.looked.image_mm, self.looked.physical_mm)
        return self._adjust(self.looked.image_mm @ fit.rotation.T + fit.translation_mm)

    @cached_property
    def fit(self) -> Registration:
        places_mm, covariances_mm2 = self._coarse.spheres_mm(self._rows)
        one_each = self._one_each
        measured = one_each.ct_mm2 + one_each.seating_mm2
        return register(one_each.image_mm, places_mm, covariance_mm2=measured + covariances_mm2)

    @cached_property
    def learning(self) -> ArmLearning:
        """Adjustment from the registration."""
        return self._adjust(np.asarray(self.fit.transform.apply(self.looked.image_mm)))

    @property
    def checks(self) -> tuple[SphereCheck, ...]:
        return check_looks(self._checked)

    def without(self, place: int) -> Self:
        rows = [row for kept, of in enumerate(self._rows) if kept != place for row in of]
        rows.sort()
        return replace(self, looked=self.looked.at(rows), errors=tuple(at_looks(self.errors, rows)))

    def find_moved(self) -> tuple[Group, ...]:
        moved = self._checked.moved
        if len(self.fiducials) <= FEWEST_PAIRS or not moved.is_probable[0]:
            return ()
        found: list[Group] = []
        for group in moved.suspects():
            with suppress(CollinearPoints):
                if len(group) > 1 or self.without(group[0])._checked.passed[0]:
                    found.append(group)
        if len(found) == 1 and len(found[0]) == 1:  # what many looks leave open may hide a second one
            rest = self.without(found[0][0])._checked
            if rest.chi_squares[0] > chi_square_limit(rest.freedom, LEFT_OUT_CONFIDENCE):
                return ()
        return tuple(found)

    def find_unnoticed(self, tip_mm: Array, sources: Sequence[Source]) -> UnnoticedPoint:
        return self.learning.find_unnoticed(self._passing, tip_mm, *self._split(sources))

    def predict(self, tip_mm: Array, sources: Sequence[Source]) -> LearnedTarget:
        return self.learning.at_target(tip_mm, *self._split(sources), self._moved_together)

    def learned(self, corrections: Mapping[str, LearnedTarget]) -> LearnedArm:
        """Return the size of the arm's errors, the spheres as it sees them, and the targets' corrections."""
        return LearnedArm(
            looks=len(self.looked.looks),
            share=self.learning.share,
            scatter_mm=self.learning.scatter_mm,
            fiducials=self.fiducials,
            spheres_robot_mm=tuple(self.fit.physical_mm.tolist()),
            corrections_mm={name: tuple(one.shift_mm.tolist()) for name, one in corrections.items()},
            correction_limits_mm={name: one.limit_mm for name, one in corrections.items()},
        )

    @cached_property
    def _checked(self) -> CheckedLooks:
        each = self._one_each
        of_spheres = IndependentErrors(CT, each.ct_mm2 + each.seating_mm2, np.zeros((3, 3)))
        common_mm2 = covariance_of([of_spheres, each.scan])
        view = TrackerView.of(each.image_mm, each.tracker_mm, each.tracker_mm2, common_mm2)
        return self._coarse.check(self._rows, error_budget.GATE_CONFIDENCE, view)

    @cached_property
    def _passing(self) -> PassingDisplacements:
        """Displacements of single spheres that the checks let pass."""
        return self.learning.find_passing(self._rows, error_budget.GATE_CONFIDENCE, error_budget.GROSS_MM)

    @cached_property
    def _moved_together(self) -> MovedTogether | None:
        """Two spheres that moved alike, which the gate hardly sees."""
        names = [str(fiducial + 1) for fiducial in self.fiducials]
        return self.learning.find_moved_together(dict(zip(names, self._rows, strict=True)))

    @cached_property
    def _rows(self) -> list[list[int]]:
        """Places of the looks at each sphere."""
        return [
            [row for row, of in enumerate(self.looked.fiducials) if of == fiducial]
            for fiducial in self.fiducials
        ]

    @property
    def _one_each(self) -> LookedPairs:
        """The first look at each sphere."""
        return self.looked.at([rows[0] for rows in self._rows])

    def _adjust(self, mapped_mm: Array) -> ArmLearning:
        nothing = np.zeros((3, 3))
        spheres = [
            IndependentErrors(CT, self.looked.ct_mm2, nothing),
            IndependentErrors(SEATING, self.looked.seating_mm2, nothing),
            IndependentErrors(STEREO, self.looked.stereo_mm2, nothing),
        ]
        arm, others = self._split([*spheres, self.looked.scan, *self.errors])
        return ArmLearning.of(Looks(self.looked.physical_mm - mapped_mm, mapped_mm, arm, others))

    def _split(self, sources: Sequence[Source]) -> tuple[list[Source], list[Source]]:
        """Split sources into those that the arm's size scales, and the rest, by sphere where it has them."""
        learned = {one.source for one in self.errors} - {REPEATABILITY}
        others: list[Source] = []
        for one in sources:
            if one.source in learned:
                continue
            if isinstance(one, IndependentErrors) and one.source in OF_SPHERES:
                others.append(share_by_sphere(one, self.looked.fiducials))
            else:
                others.append(one)
        return [one for one in sources if one.source in learned], others
