"""Strategy `learning` against all others in the same cases: three targets, one head, one arm of its own.

Held out: neither the places of the head nor the trajectories are those of any other study, and every case has
an arm, a CT and noise of its own. The arms are what the strategy is told, half and twice as bad, or have an
effect that the model of the arm lacks. A trajectory that not every strategy reaches is passed over and
counted.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm_sources import SERVO_MM
from procedures.guards.stability import GUIDE_NOTICEABLE_MM
from procedures.registration.rigid_fit import fit_rigid, residuals
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED_MM
from ronna_hw.errors import RonnaError
from studies.accuracy.many_learned import LearnedRegistration, PlainRegistration
from studies.accuracy.phantom import FREE_SPHERES, Markers, Phantom, counts_of, draw_phantom, phantom_pose
from studies.accuracy.postures import ARM
from studies.accuracy.random_arms import PlannedPoses, RandomArms, centre_on_spheres, reach_positions
from studies.accuracy.scene import AXES, BEST, FINE_CT_MM, FROM, Scenario
from studies.accuracy.unmodelled_effects import DisplacedArms, DrawnEffect, Effect, load_levers
from studies.campaign.study import Study, Sums, Unit, blocks_of_each
from studies.strategies.case_plans import (
    LEARNING,
    SEPARATE,
    CasePlanner,
    PlannedLooks,
    join,
)
from studies.strategies.study import DEPTHS_MM
from studies.strategies.unmodelled_arm import DIAL_MM, GAUGE_S, READINGS, TARGET_S

PLACES = tuple(range(17, 25))  # other studies use 1 to 8, an earlier run of this one 9 to 16
FIRST_TRAJECTORY = 40  # likewise: the first ten, and 40
DRAWN = 80
TARGETS_OF_CASE, CASES = 3, 3  # at each place
SHARES = (0.5, 1.0, 2.0)
SCENARIOS = {
    "uncalibrated": Scenario("uncalibrated", ct_mm=FINE_CT_MM),
    "calibrated": Scenario("calibrated", tool=True, kinematics=True, ct_mm=FINE_CT_MM),
}
BLOCK_ARMS = 50
NOISE_KEY = 15  # of the random numbers
PER_PLACE, PER_CASE = 1_000_000, 10_000  # of the arms' numbers
REFUSAL = 0.999  # confidence of the limit of the residual
DIGITS = 4
SIZES, EFFECTS = "sizes", "effects"
# A moved sphere is no effect of an arm, and this study moves none.
ARM_EFFECTS = tuple(one for one in Effect if one not in (Effect.NOTHING, Effect.SPHERE_MOVED))
# Every case is run under each: name, size of the arm's errors by that stated, effect.
CONDITIONS = (
    *((f"{SIZES}|{share:g}", share, Effect.NOTHING) for share in SHARES),
    *((f"{EFFECTS}|{effect}", 1.0, effect) for effect in ARM_EFFECTS),
)
# Share of the looks before a bump that is before or after all of them.
BUMPED_FROM = {Effect.BUMP_BEFORE: 0.0, Effect.BUMP_AFTER: 2.0}
PASSED_OVER, ERROR = "passed over", "error "
RESIDUAL, SUSPECT, GAUGE = "residual", "suspect", "gauge"  # reasons of a refusal


@dataclass(frozen=True)
class LearningStudy(Study):
    """Study of `arms` cases at each place and set of targets."""

    arms: int = 20
    seed: int = 0
    places: tuple[int, ...] = PLACES
    first_trajectory: int = FIRST_TRAJECTORY
    name: str = "strategies-learning"

    constants: ClassVar = {"targets_of_case": TARGETS_OF_CASE, "cases": CASES, "ct_mm": FINE_CT_MM}

    def units(self) -> Sequence[Unit]:
        return blocks_of_each(
            ((kind, place) for kind in SCENARIOS for place in self.places), self.arms, BLOCK_ARMS
        )

    def run(self, unit: Unit) -> Sums:
        """Return errors in mm and sums, keyed `part|share or effect|strategy|spheres|quantity`."""
        kind, place = unit.condition.split("|")
        groups, passed_over = reached_cases(int(place), self.first_trajectory)
        found: Sums = defaultdict(float)
        found[PASSED_OVER] = float(passed_over) * (unit.block == 0)
        for case, phantom in enumerate(groups):
            bench = Bench.of(kind, int(place), phantom)
            first = int(place) * PER_PLACE + case * PER_CASE + unit.block * BLOCK_ARMS
            numbers = range(first, first + unit.runs)
            bench.run(CaseDraws.of(self.seed, numbers, SCENARIOS[kind]), found)
        return dict(found)


@cache
def reached_cases(place: int, first_trajectory: int) -> tuple[tuple[Phantom, ...], int]:
    """Draw the trajectories of a place that every strategy reaches, by case, and count those passed over."""
    drawn = draw_phantom(Markers.FREE, DEPTHS_MM, DRAWN)
    reached, passed_over = [], 0
    for trajectory in drawn.trajectories[first_trajectory:]:
        alone = replace(drawn, trajectories=(trajectory,))
        try:
            for kind in SCENARIOS:
                _ = plan_case(kind, alone, place).postures
        except RonnaError:
            passed_over += 1
            continue
        reached.append(trajectory)
        if len(reached) == CASES * TARGETS_OF_CASE:
            break
    starts = range(0, CASES * TARGETS_OF_CASE, TARGETS_OF_CASE)
    return (
        tuple(replace(drawn, trajectories=tuple(reached[one : one + TARGETS_OF_CASE])) for one in starts),
        passed_over,
    )


def plan_case(kind: str, phantom: Phantom, place: int) -> CasePlanner:
    """Return the planner of a case with arms of one kind, `uncalibrated` or `calibrated`."""
    scenario = SCENARIOS[kind]
    return CasePlanner(phantom, phantom_pose(place), scenario.remaining_errors("ocs"), scenario.ct_mm)


@dataclass(frozen=True)
class CaseDraws:
    """Cases of `a` arms, each under one condition, and their random errors with unit standard deviation."""

    conditions: tuple[str, ...]
    numbers: tuple[int, ...]
    arms: RandomArms
    effects: tuple[DrawnEffect, ...]
    bumped_from: Array  # (a,) share of the looks before a bump
    ct: Array  # (a, n, 3)
    looks: Array  # (a, kinds, t, n, 3)
    rest: Array  # (a, t, 3)
    gauge: Array  # (a, t + 1, 3)

    @classmethod
    def of(cls, seed: int, numbers: Sequence[int], scenario: Scenario) -> CaseDraws:
        """Draw the numbered cases under all conditions.

        Conditions and strategies share the draws, so they are compared on equal terms.
        """
        rows = []
        for number in numbers:
            random = np.random.default_rng(np.random.SeedSequence([seed, NOISE_KEY, number]))
            rows.append(
                (
                    random.uniform(),
                    random.normal(size=(FREE_SPHERES, AXES)),
                    random.normal(size=(len(FROM), TARGETS_OF_CASE, FREE_SPHERES, AXES)),
                    random.normal(size=(TARGETS_OF_CASE, AXES)),
                    random.normal(size=(TARGETS_OF_CASE + 1, AXES)),
                )
            )
        uniform, *normal = (np.array(column) for column in zip(*rows, strict=True))
        every = [(condition, number) for condition in CONDITIONS for number in numbers]
        repeated = [number for _, number in every]
        drawn = scenario.scale(RandomArms.draw(seed, repeated), "ocs")
        return cls(
            tuple(name for (name, _, _), _ in every),
            tuple(repeated),
            drawn.times(np.array([share for (_, share, _), _ in every])),
            tuple(DrawnEffect.draw(effect, seed, number) for (_, _, effect), number in every),
            np.concatenate(
                [
                    np.full(len(numbers), BUMPED_FROM[effect]) if effect in BUMPED_FROM else uniform
                    for _, _, effect in CONDITIONS
                ]
            ),
            *(np.concatenate([one] * len(CONDITIONS)) for one in normal),
        )

    def displaced(
        self, poses: PlannedPoses, points_mm: Array, moved_s: Array, bumped: NDArray[np.bool_]
    ) -> DisplacedArms:
        """Place the arms at poses (p,) with their effects; `bumped` (a, p) marks a flange bumped by then."""
        shifts_rad, shifts_mm = [], []
        levers = load_levers(ARM.chain, poses.joints_rad, points_mm)
        for one, flags in zip(self.effects, bumped, strict=True):
            shifts_rad.append(one.shift_by_load_rad(poses.joints_rad, levers, moved_s))
            shifts_mm.append(one.shift_mm(moved_s) + flags[:, None] * (poses.rotations @ one.bump_mm))
        return DisplacedArms.at(self.arms, np.array(shifts_rad), np.array(shifts_mm))

    def off_gauge(self, planned: PlannedLooks, target_mm: Array, gauged_s: Array) -> NDArray[np.bool_]:
        """Mark the targets (a, t) before or after which the guide is off its gauge, read cold before all."""
        read_s = np.concatenate([[0.0], gauged_s])
        poses = select_poses(planned.targets, np.zeros(len(read_s), dtype=np.intp))
        bumped = np.broadcast_to(np.arange(len(read_s)) > 0, (len(self.arms), len(read_s)))
        flanks = np.broadcast_to(planned.target_arrival[0], (len(self.arms), *poses.joints_rad.shape))
        on_gauge = self.displaced(poses, np.tile(target_mm, (len(read_s), 1)), read_s, bumped)
        read = on_gauge.tool_points_mm(np.broadcast_to(poses.joints_rad, flanks.shape), flanks)
        noise_mm = np.hypot(self.arms.repeatability_mm, DIAL_MM) / np.sqrt(READINGS) * self.gauge
        is_off = np.linalg.norm(read[:, 1:] - read[:, :1] + noise_mm, axis=2) > GUIDE_NOTICEABLE_MM
        return np.asarray(is_off[:, :-1] | is_off[:, 1:])


@dataclass(frozen=True)
class Prepared:
    """Looks of one strategy in their order, and the registrations by which it reaches its targets."""

    looks: PlannedLooks
    seconds: Array
    registrations: tuple[
        tuple[tuple[int, ...], NDArray[np.intp], LearnedRegistration | PlainRegistration], ...
    ]

    @classmethod
    def of(cls, planner: CasePlanner, looks: PlannedLooks, *, learns: bool) -> Prepared:
        """Put the looks in order and prepare their registrations; targets with the same looks share one."""
        ordered = looks.in_order()
        shared: dict[tuple[int, ...], list[int]] = defaultdict(list)
        for target, used in enumerate(ordered.used):
            shared[tuple(used.tolist())].append(target)
        arm_mm, registrations = UNCALIBRATED_MM * planner.sizes.links, []
        for key, targets in shared.items():
            used = np.array(key, dtype=np.intp)
            points_mm, sources = planner.sources(ordered, used, targets)
            made = (
                LearnedRegistration.of(points_mm, ordered.spheres[used].tolist(), sources)
                if learns
                else PlainRegistration.of(points_mm, sources, arm_mm)
            )
            registrations.append((tuple(targets), used, made))
        return cls(ordered, ordered.seconds, tuple(registrations))


@dataclass(frozen=True)
class Bench:
    """One place and three targets, with the looks of every strategy by number of spheres."""

    planner: CasePlanner
    prepared: Mapping[tuple[str, int], Prepared]

    @classmethod
    def of(cls, kind: str, place: int, phantom: Phantom) -> Bench:
        """Plan and prepare all strategies."""
        planner = plan_case(kind, phantom, place)
        planned = {strategy: planner.separate(strategy) for strategy in SEPARATE}
        candidates = planner.candidates()
        prepared: dict[tuple[str, int], Prepared] = {}
        for count in counts_of(Markers.FREE):
            own = {
                strategy: Prepared.of(planner, looks.of_spheres(count), learns=False)
                for strategy, looks in planned.items()
            }
            predicted = np.array([_predicted_mm2(own[strategy]) for strategy in FROM]).argmin(axis=0)
            best = join([own[FROM[number]].looks for number in predicted])
            learning = planner.choose(candidates, count)
            prepared |= {(strategy, count): one for strategy, one in own.items()}
            prepared[BEST, count] = Prepared.of(planner, best, learns=False)
            prepared[LEARNING, count] = Prepared.of(planner, learning, learns=True)
        return cls(planner, prepared)

    def run(self, draws: CaseDraws, found: Sums) -> None:
        """Run all strategies on the drawn cases and add what they reach to `found`."""
        conditions = np.array(draws.conditions)
        for (strategy, count), prepared in self.prepared.items():
            errors_mm, limits_mm, refused = self._try_looks(draws, prepared)
            used = ~np.any(list(refused.values()), axis=0)
            for condition in dict.fromkeys(draws.conditions):
                key, here = f"{condition}|{strategy}|{count}", conditions == condition
                cases, counted = int(here.sum()), used & here[:, None]
                found[f"{key}|cases"] += cases
                found[f"{key}|looks"] += cases * len(prepared.seconds)
                found[f"{key}|seconds"] += cases * float(prepared.seconds[-1])
                for by, is_refused in refused.items():
                    found[f"{key}|{by}"] += float(is_refused[here].sum())
                found[f"{key}|used"] += float(counted.sum())
                found[f"{key}|inside"] += float((counted & (errors_mm <= limits_mm)).sum())
                found[f"{key}|limit"] += float((counted * limits_mm).sum())
                for arm, target in np.argwhere(counted):
                    name = f"{ERROR}{draws.numbers[arm]}.{target + 1}"
                    found[f"{key}|{name}"] = round(float(errors_mm[arm, target]), DIGITS)

    def _try_looks(
        self, draws: CaseDraws, prepared: Prepared
    ) -> tuple[Array, Array, dict[str, NDArray[np.bool_]]]:
        """Return errors and limits (a, t) mm, and what is refused, by reason."""
        looks, planner, cases = prepared.looks, self.planner, len(draws.arms)
        count, targets = len(looks.spheres), len(planner.targets_mm)
        bumped = np.arange(count) >= np.ceil(draws.bumped_from * (count - 1))[:, None]  # one look or more
        points = planner.spheres_mm[looks.spheres]
        at_looks = draws.displaced(looks.poses, points, prepared.seconds, bumped)
        sides = np.broadcast_to(looks.arrival, (cases, *looks.arrival.shape))
        _, recorded = centre_on_spheres(at_looks, looks.poses, points, sides)
        kinds, of_targets = np.array(looks.draws).T
        noise_mm = np.hypot(SERVO_MM / np.sqrt(AXES), draws.arms.repeatability_mm)
        recorded = recorded + noise_mm * draws.looks[:, kinds, of_targets, looks.spheres]
        image = planner.phantom.spheres_mm + planner.ct_mm / np.sqrt(AXES) * draws.ct
        targets_ct = np.array([one.target_mm for one in planner.phantom.trajectories])
        places, limits_mm = np.empty((cases, targets, AXES)), np.empty((cases, targets))
        is_unlike, is_suspect = np.zeros((2, cases, targets), dtype=bool)
        for group, used, registration in prepared.registrations:
            seen, there = image[:, looks.spheres[used]], recorded[:, used]
            fit = fit_rigid(seen, there)
            judged = registration.judge(residuals(fit, seen, there))
            mapped = np.einsum("aij,tj->ati", fit.rotation, targets_ct[list(group)])
            places[:, group] = mapped + fit.translation_mm[:, None] + judged.shifts_mm
            limits_mm[:, group] = judged.limits_mm()
            is_unlike[:, group] = judged.refused(REFUSAL)[:, None]
            is_suspect[:, group] = judged.suspect[:, None]
        gauged_s = prepared.seconds[-1] + GAUGE_S + TARGET_S * np.arange(targets + 1, dtype=float)
        reached_s = gauged_s[:-1] + 0.5 * TARGET_S
        always = np.ones((cases, targets), dtype=bool)
        at_targets = draws.displaced(looks.targets, planner.targets_mm, reached_s, always)
        joints = reach_positions(draws.arms, looks.targets, places)
        flanks = np.broadcast_to(looks.target_arrival, (cases, *looks.target_arrival.shape))
        tips = at_targets.tool_points_mm(joints, flanks) + draws.arms.repeatability_mm * draws.rest
        is_off = draws.off_gauge(looks, planner.targets_mm[0], gauged_s)
        errors_mm = np.linalg.norm(tips - planner.targets_mm, axis=2)
        is_suspect &= ~is_unlike
        refused = {RESIDUAL: is_unlike, SUSPECT: is_suspect, GAUGE: is_off & ~is_unlike & ~is_suspect}
        return errors_mm, limits_mm, refused


def _predicted_mm2(prepared: Prepared) -> Array:
    """Return the predicted mean square error (t,) at each target, of looks that learn nothing."""
    found = np.empty(len(prepared.looks.used))
    for group, _, registration in prepared.registrations:
        assert isinstance(registration, PlainRegistration)
        found[list(group)] = np.trace(registration.covariances_mm2, axis1=1, axis2=2)
    return found


def select_poses(poses: PlannedPoses, kept: NDArray[np.intp]) -> PlannedPoses:
    """Return some of the poses, in this order."""
    return replace(
        poses,
        joints_rad=poses.joints_rad[kept],
        rotations=poses.rotations[kept],
        inverse=poses.inverse[kept],
    )
