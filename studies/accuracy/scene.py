"""Strategies run on random arms at one phantom position, in scenarios of calibration and CT.

A trial localizes, registers and goes to the target. Every random number belongs to the seed, the markers, the
arm and the position, so an error does not depend on which arms are run together. The CT of an arm's phantom
is scanned once and used in all positions, as in the thesis. The orientation at the target is the planned one:
the finer transform turns it by less than a degree.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.calibration.arm_sources import SERVO_MM, ArmPoses, arm_sources, ct_errors
from procedures.registration.rigid_fit import fit_rigid, residuals
from procedures.registration.target_prediction import (
    IndependentErrors,
    SharedErrors,
    TargetPrediction,
    predict_target_error,
)
from procedures.strategies.catalogue import CANDIDATES, find_strategy
from procedures.strategies.strategy import Strategy
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED, ErrorSizes
from ronna_hw.frames import Transform
from sim.world.scene.arm_design import KR6
from sim.world.scene.as_built import TOOL_ERROR_MM
from sim.world.scene.model import ArmResidual
from studies.accuracy.phantom import Markers, Phantom, counts_of, phantom_pose
from studies.accuracy.postures import ARM, Postures, plan_postures
from studies.accuracy.random_arms import RandomArms, Source, centre_on_spheres, reach_positions
from studies.campaign.study import Sums
from studies.sphere_errors import AS_IN_A_CASE, SET_S_RMS_MM

AS_BUILT = KR6.errors
CALIBRATED = ArmResidual()
# Backlash as known after calibration: twice the error that `ronna-campaign strategies --identified` finds.
CALIBRATED_BACKLASH_RAD = float(np.radians(0.0015))
FINE_CT_MM = AS_IN_A_CASE.rms_mm  # 3-D rms, seating included
ANY_APPROACH = "thesis-ocs"
DIGITS = 6  # of an error in mm
BEST = "best"  # per target and number of spheres, the strategy with the smallest predicted error
FROM = tuple(one.name for one in CANDIDATES)
CT_FLE_MM = SET_S_RMS_MM  # 3-D rms, seating included
AXES = 3
CT_KEY, LOOKS_KEY, GUIDE_KEY = 7, 8, 10  # of the random numbers; 9 is that of identification


@dataclass(frozen=True)
class Chance:
    """Random errors not inherent to the `a` arms, with unit standard deviation per axis."""

    ct: Array  # (a, n, 3)
    servo: Array  # (a, s, n, 3) of every localization
    rest: Array  # (a, s, n, 3) the same, for the arm at rest
    sides: Array  # (a, s, n, 6) -1 or 1: side on which the servo's last step may leave each joint
    target_rest: Array  # (a, t, 3) for the arm at rest at the target
    guide: Array  # (a, 2) direction of the bore, across the tool axis; the same in every place

    @classmethod
    def draw(
        cls,
        seed: int,
        markers: Markers,
        arms: Sequence[int],
        place: int,
        shape: tuple[int, int],
        *,
        scan_again: bool = False,
    ) -> Self:
        """Draw for the numbered arms at a position. `shape` is (targets, spheres).

        Strategies share the draws, so they are compared on equal terms. `scan_again` scans the
        CT at every position.
        """
        kind = zlib.crc32(markers.encode())
        targets, spheres = shape
        rows = []
        for number in arms:
            scan = [CT_KEY, number, place] if scan_again else [CT_KEY, number]
            ct = np.random.default_rng(np.random.SeedSequence([seed, kind, *scan]))
            looks = np.random.default_rng(np.random.SeedSequence([seed, kind, LOOKS_KEY, number, place]))
            guide = np.random.default_rng(np.random.SeedSequence([seed, GUIDE_KEY, number]))
            rows.append(
                (
                    ct.normal(size=(spheres, AXES)),
                    looks.normal(size=(targets, spheres, AXES)),
                    looks.normal(size=(targets, spheres, AXES)),
                    looks.choice((-1.0, 1.0), size=(targets, spheres, 6)),
                    looks.normal(size=(targets, AXES)),
                    guide.normal(size=2),
                )
            )
        return cls(*(np.array(column) for column in zip(*rows, strict=True)))


@dataclass(frozen=True)
class Sizes:
    """Magnitudes of the errors outside the arm, as 3-D rms in mm.

    `guide_rad` per axis is the direction of the guide's bore in the tool. It acts only on a trajectory on
    which the guide rests before the target.
    """

    ct_mm: float = CT_FLE_MM
    servo_mm: float = SERVO_MM
    guide_rad: float = 0.0

    def only(self, source: Source) -> Sizes:
        """Return the sizes with all but one error source set to zero."""
        return Sizes(
            self.ct_mm if source is Source.CT else 0.0, self.servo_mm if source is Source.REST else 0.0
        )


@dataclass(frozen=True)
class Scenario:
    """A scenario: which parts of the arm are calibrated, and the CT error (3-D rms).

    The levels are those assumed for a calibrated arm; harmonics and sag are those of set S, and so is
    backlash unless it is `known`. Without control of the approach, the side of a joint is never known.
    """

    name: str
    tool: bool = False
    kinematics: bool = False
    known: bool = False  # the backlash, to CALIBRATED_BACKLASH_RAD
    ct_mm: float = CT_FLE_MM

    def remaining_errors(self, strategy: str) -> ErrorSizes:
        """Return the arm errors remaining in this scenario."""
        return replace(
            UNCALIBRATED,
            tool_mm=CALIBRATED.tool_mm if self.tool else TOOL_ERROR_MM,
            links=CALIBRATED.angle_rad / AS_BUILT.link_rotation_rad if self.kinematics else 1.0,
            backlash=self._remaining_backlash(strategy),
        )

    def _remaining_backlash(self, strategy: str) -> float:
        known = self.known and strategy != ANY_APPROACH
        return CALIBRATED_BACKLASH_RAD / AS_BUILT.backlash_rad if known else 1.0

    def scale(self, arms: RandomArms, strategy: str) -> RandomArms:
        """Scale the arms' errors down to those remaining for a strategy after calibration."""
        arms = replace(arms, backlash_rad=arms.backlash_rad * self._remaining_backlash(strategy))
        if self.tool:
            arms = replace(arms, tool_error_mm=arms.tool_error_mm * CALIBRATED.tool_mm / TOOL_ERROR_MM)
        if not self.kinematics:
            return arms
        turns = Rotation.from_matrix(arms.link_rotation.reshape(-1, 3, 3)).as_rotvec()
        remaining = Rotation.from_rotvec(
            turns * CALIBRATED.angle_rad / AS_BUILT.link_rotation_rad
        ).as_matrix()
        return replace(
            arms,
            link_translation_mm=arms.link_translation_mm * CALIBRATED.link_mm / AS_BUILT.link_translation_mm,
            link_rotation=remaining.reshape(arms.link_rotation.shape),
            joint_offset_rad=arms.joint_offset_rad * CALIBRATED.angle_rad / AS_BUILT.joint_offset_rad,
        )


SET_S = Scenario("set S")


SCENARIOS = (
    SET_S,
    Scenario("tool calibrated", tool=True),
    Scenario("tool and kinematics calibrated", tool=True, kinematics=True),
    Scenario("spheres as in a case", ct_mm=FINE_CT_MM),
    Scenario("tool calibrated, spheres as in a case", tool=True, ct_mm=FINE_CT_MM),
    Scenario(
        "tool and kinematics calibrated, spheres as in a case", tool=True, kinematics=True, ct_mm=FINE_CT_MM
    ),
    Scenario("the same, backlash known too", tool=True, kinematics=True, known=True, ct_mm=FINE_CT_MM),
)


@dataclass(frozen=True)
class ReachedTargets:
    """Registered and reached places of targets, as vectors from the true ones; (a, t, c, ...) in mm.

    The difference of the two is the arm's own error at the target (eq. 40 to 42 of the thesis).
    """

    registered_mm: Array  # (a, t, c, 3)
    reached_mm: Array  # (a, t, c, 3)
    fre_mm: Array  # (a, t, c) of the registration used


@dataclass(frozen=True)
class DrawnOutcome:
    """Error vectors (arms, targets, sphere counts, 3) in mm, and predictions by sphere count and target."""

    errors_mm: Array
    predictions: list[list[TargetPrediction]]


@dataclass(frozen=True)
class StudiedScene:
    """A phantom with its markers at position `number`. Registrations use `counts` spheres."""

    seed: int
    markers: Markers
    number: int
    phantom: Phantom
    robot_from_ct: Transform
    counts: tuple[int, ...]
    own: tuple[Strategy, ...] = ()

    @classmethod
    def of(
        cls, seed: int, phantom: Phantom, markers: Markers, number: int, own: tuple[Strategy, ...] = ()
    ) -> Self:
        """Build a scene with all sphere counts possible for the markers. `own` are user strategies."""
        return cls(seed, markers, number, phantom, phantom_pose(number), counts_of(markers), own)

    @property
    def targets(self) -> int:
        return len(self.phantom.trajectories)

    def planned(self, strategy: str, sizes: ErrorSizes = UNCALIBRATED) -> Postures:
        """Plan a strategy's poses at this position, for arms with these errors. Raises STU-010."""
        own = {one.name: one for one in self.own}
        chosen = own.get(strategy) or find_strategy(strategy)
        return plan_postures(chosen, self.phantom, self.robot_from_ct, sizes)

    def predictions(
        self, planned: Postures, sizes: ErrorSizes = UNCALIBRATED, ct_mm: float = CT_FLE_MM
    ) -> list[list[TargetPrediction]]:
        """Predict target errors of an unweighted fit, by sphere count and target."""
        return [
            [self._predict_target(planned, number, count, sizes, ct_mm) for number in range(self.targets)]
            for count in self.counts
        ]

    def _predict_target(
        self, planned: Postures, target: int, count: int, sizes: ErrorSizes, ct_mm: float
    ) -> TargetPrediction:
        spheres = self.robot_from_ct.apply(self.phantom.spheres_mm[:count])
        target_mm = self.robot_from_ct.apply(self.phantom.trajectories[target].target_mm)
        return predict_target_error(
            spheres, target_mm, self.error_sources(planned, target, count, sizes, ct_mm)
        )

    def error_sources(
        self, planned: Postures, target: int, count: int, sizes: ErrorSizes, ct_mm: float
    ) -> list[SharedErrors | IndependentErrors]:
        """List the sources of the predicted error at a target registered by the first `count` spheres."""
        spheres = self.robot_from_ct.apply(self.phantom.spheres_mm)
        target_mm = self.robot_from_ct.apply(self.phantom.trajectories[target].target_mm)
        first = planned.set_of(target) * len(spheres)
        looks = slice(first, first + count)
        at_spheres = ArmPoses(
            planned.localizations.joints_rad[looks], spheres[:count], planned.arrival[looks]
        )
        at_target = ArmPoses(
            planned.targets.joints_rad[[target]], target_mm[None], planned.target_arrival[[target]]
        )
        ct = np.tile(np.eye(AXES) * ct_mm**2 / AXES, (count, 1, 1))
        return [*arm_sources(ARM.chain, at_spheres, at_target, sizes), ct_errors(ct)]

    def chance(self, arms: Sequence[int], *, scan_again: bool = False) -> Chance:
        shape = self.targets, len(self.phantom.spheres_mm)
        return Chance.draw(self.seed, self.markers, arms, self.number, shape, scan_again=scan_again)

    def errors_mm(
        self, arms: RandomArms, planned: Postures, chance: Chance, sizes: Sizes, *, any_side: bool = False
    ) -> Array:
        """Return error vectors (a, t, c, 3) in mm, robot frame: tip minus target, for each sphere count."""
        return self.reach_targets(arms, planned, chance, sizes, any_side=any_side).reached_mm

    def reach_targets(
        self, arms: RandomArms, planned: Postures, chance: Chance, sizes: Sizes, *, any_side: bool = False
    ) -> ReachedTargets:
        """Localize, register and go to every target, with each sphere count.

        Where the tool rests before the target, a straight instrument goes on along its true axis. With
        `any_side`, the servo's last step leaves each joint on either side of its backlash at the spheres;
        without it, the line of approach to a sphere decides, or a strategy that controls it.
        """
        targets_ct = np.array([one.target_mm for one in self.phantom.trajectories])
        recorded = self._localize_spheres(arms, planned, chance, sizes, any_side)
        image = self.phantom.spheres_mm + sizes.ct_mm / np.sqrt(AXES) * chance.ct
        serving = [planned.set_of(target) for target in range(self.targets)]
        flanks = np.broadcast_to(planned.target_arrival, (len(arms), *planned.target_arrival.shape))
        true_targets = self.robot_from_ct.apply(targets_ct)
        beyond_mm = np.array([[one.beyond_mm] for one in self.phantom.trajectories])
        axes = planned.targets.rotations[..., 2]
        bores = np.concatenate([sizes.guide_rad * chance.guide, np.ones((len(arms), 1))], axis=1)
        along = replace(arms, tool_error_mm=arms.tool_error_mm + bores)
        registered, reached, fre = [], [], []
        for count in self.counts:
            fit = fit_rigid(image[:, None, :count], recorded[:, :, :count])
            left_mm = residuals(fit, image[:, None, :count], recorded[:, :, :count])
            fre.append(np.sqrt(np.square(left_mm).sum(axis=-1).mean(axis=-1))[:, serving])
            places = np.einsum("atij,tj->ati", fit.rotation[:, serving], targets_ct)
            places = places + fit.translation_mm[:, serving]
            registered.append(places - true_targets)
            joints = reach_positions(arms, planned.targets, places + beyond_mm * axes)
            tips = arms.tool_points_mm(joints, flanks)
            if beyond_mm.any():
                tips = tips - beyond_mm * (along.tool_points_mm(joints, flanks) - tips)
            reached.append(tips + arms.repeatability_mm * chance.target_rest - true_targets)
        return ReachedTargets(*(np.stack(each, axis=2) for each in (registered, reached, fre)))

    def _localize_spheres(
        self, arms: RandomArms, planned: Postures, chance: Chance, sizes: Sizes, any_side: bool
    ) -> Array:
        """Return the believed sphere positions, (a, s, n, 3) mm."""
        spheres = self.robot_from_ct.apply(self.phantom.spheres_mm)
        count, sets = len(spheres), planned.sets
        sides = np.broadcast_to(planned.arrival, (len(arms), *planned.arrival.shape))
        if any_side:
            sides = chance.sides[:, :sets].reshape(sides.shape)
        _, believed = centre_on_spheres(arms, planned.localizations, np.tile(spheres, (sets, 1)), sides)
        noise = sizes.servo_mm / np.sqrt(AXES) * chance.servo + arms.repeatability_mm * chance.rest
        return np.asarray(believed.reshape(len(arms), sets, count, AXES) + noise[:, :sets])

    def outcomes(
        self,
        strategies: Sequence[str],
        arms: RandomArms,
        chance: Chance,
        scenario: Scenario = SET_S,
        *,
        any_side: bool = False,
    ) -> dict[str, DrawnOutcome]:
        """Run the strategies on arms of set S, with planning and prediction adapted to the scenario."""
        single = dict.fromkeys(
            (*(FROM if BEST in strategies else ()), *(one for one in strategies if one != BEST))
        )
        found = {}
        for one in single:
            errors = scenario.remaining_errors(one)
            planned, remaining = self.planned(one, errors), scenario.scale(arms, one)
            found[one] = DrawnOutcome(
                self.errors_mm(remaining, planned, chance, Sizes(scenario.ct_mm), any_side=any_side),
                self.predictions(planned, errors, scenario.ct_mm),
            )
        if BEST in strategies:
            found[BEST] = _choose_best([found[one] for one in FROM])
        return {one: found[one] for one in strategies}

    def trials(
        self,
        arms: Sequence[int],
        strategies: Sequence[str],
        *,
        scenario: Scenario = SET_S,
        scan_again: bool = False,
        any_side: bool = False,
    ) -> Sums:
        """Return all error lengths in mm, keyed `strategy|spheres|arm|target`."""
        drawn, chance = RandomArms.draw(self.seed, arms), self.chance(arms, scan_again=scan_again)
        found: Sums = {}
        outcomes = self.outcomes(strategies, drawn, chance, scenario, any_side=any_side)
        for strategy, outcome in outcomes.items():
            lengths = np.linalg.norm(outcome.errors_mm, axis=-1)
            for (arm, target, count), length in np.ndenumerate(lengths):
                key = f"{strategy}|{self.counts[count]}|{arms[arm]}|{target + 1}"
                found[key] = round(float(length), DIGITS)
        return found


def _choose_best(candidates: Sequence[DrawnOutcome]) -> DrawnOutcome:
    predictions = [one.predictions for one in candidates]
    chosen = np.array([[[each.rms_mm for each in row] for row in one] for one in predictions]).argmin(axis=0)
    errors_mm = np.stack([one.errors_mm for one in candidates])
    return DrawnOutcome(
        np.take_along_axis(errors_mm, chosen.T[None, None, :, :, None], axis=0)[0],
        [[predictions[k][count][target] for target, k in enumerate(row)] for count, row in enumerate(chosen)],
    )
