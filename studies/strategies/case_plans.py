"""Looks of one case of a few targets under each strategy, in the order in which the arm takes them.

A case has its looks first and its targets after them. Every strategy takes its looks in the order of the
shortest next move, from home; a look takes the same time with each.

Nothing is in the way here. Looks of `learning` are chosen by `look_choice.choose_looks` as in a case,
but without what `planning.learning_looks` asks of sight, approach and clearance, and with one time for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm_sources import REPEATABILITY_MM, SERVO_MM, ArmPoses, arm_sources, ct_errors
from procedures.registration.arm_hypotheses import Source, share_by_sphere
from procedures.registration.error_sources import SERVO
from procedures.registration.look_choice import Candidates, choose_looks
from procedures.strategies.catalogue import CANDIDATES, find_strategy
from procedures.strategies.names import DEFAULT_STRATEGY
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import ErrorSizes, unit_errors
from ronna_hw.frames import Transform
from studies.accuracy.many_learned import TargetSources
from studies.accuracy.phantom import Phantom
from studies.accuracy.postures import ARM, TOOL_MM, Postures, plan_candidates, plan_postures
from studies.accuracy.random_arms import PlannedPoses
from studies.accuracy.scene import AXES, BEST

LEARNING = "learning"
SEPARATE = ("nos", "ocs", "thesis-ocs", "jdms", "improved")
STRATEGIES = (*SEPARATE, BEST, LEARNING)
# From the end of the move above a sphere: line down, servo, two pictures at rest, line up. (U)
LOOK_S = 3.0
LOOK_WITH_WAY_S = 5.0  # for the choice of looks, made before their order
LIMITS = working_limits(ARM)


@dataclass(frozen=True)
class PlannedLooks:
    """Looks (m,) of a case: joints, side of the backlash and sphere of each, and its random draw.

    `used` are the looks by which each target is registered.
    """

    joints_rad: Array  # (m, 6)
    arrival: Array  # (m, 6)
    spheres: NDArray[np.intp]
    draws: tuple[tuple[int, int], ...]  # number of the strategy among CANDIDATES, and target
    used: tuple[NDArray[np.intp], ...]
    targets: PlannedPoses
    target_arrival: Array  # (t, 6)

    @cached_property
    def poses(self) -> PlannedPoses:
        """Poses of all looks."""
        return PlannedPoses.of(ARM, TOOL_MM, self.joints_rad)

    def of_spheres(self, count: int) -> PlannedLooks:
        """Return the looks at the first spheres alone."""
        kept = np.flatnonzero(self.spheres < count)
        return self.only(kept)

    def only(self, kept: NDArray[np.intp]) -> PlannedLooks:
        """Return some of the looks, in this order."""
        place = {int(look): number for number, look in enumerate(kept)}
        used = tuple(
            np.array([place[int(look)] for look in one if int(look) in place], dtype=np.intp)
            for one in self.used
        )
        return replace(
            self,
            joints_rad=self.joints_rad[kept],
            arrival=self.arrival[kept],
            spheres=self.spheres[kept],
            draws=tuple(self.draws[look] for look in kept),
            used=used,
        )

    def in_order(self) -> PlannedLooks:
        """Return the looks in the order of the shortest next move."""
        left, order, at = list(range(len(self.spheres))), [], np.array(ARM.home_rad)
        while left:
            nearest = min(left, key=lambda look: move_s(at, self.joints_rad[look]))
            left.remove(nearest)
            order.append(nearest)
            at = self.joints_rad[nearest]
        return self.only(np.array(order, dtype=np.intp))

    @property
    def seconds(self) -> Array:
        """Time (m,) at which each look ends."""
        before = np.vstack([ARM.home_rad, self.joints_rad[:-1]])
        moves = [move_s(one, other) for one, other in zip(before, self.joints_rad, strict=True)]
        return np.cumsum(np.add(moves, LOOK_S))


def move_s(from_rad: Array, to_rad: Array) -> float:
    """Return the time of a joint move at the arm's limits, its jerk apart."""
    way = np.abs(np.subtract(to_rad, from_rad))
    speed, rise = np.array(LIMITS.speed_rad_s), np.array(LIMITS.acceleration_rad_s2)
    return float(np.where(way > speed**2 / rise, way / speed + speed / rise, 2.0 * np.sqrt(way / rise)).max())


@dataclass(frozen=True)
class CasePlanner:
    """Phantom with the trajectories of one case, where it is, and what is stated of the arm and the CT."""

    phantom: Phantom
    robot_from_ct: Transform
    sizes: ErrorSizes
    ct_mm: float  # 3-D rms

    @cached_property
    def spheres_mm(self) -> Array:
        """Spheres (n, 3) mm in the robot frame."""
        return np.asarray(self.robot_from_ct.apply(self.phantom.spheres_mm))

    @cached_property
    def targets_mm(self) -> Array:
        """Targets (t, 3) mm in the robot frame."""
        return np.asarray(
            self.robot_from_ct.apply(np.array([one.target_mm for one in self.phantom.trajectories]))
        )

    @cached_property
    def postures(self) -> dict[str, Postures]:
        """Postures of all strategies but those made of them. Raises STU-010."""
        return {
            one: plan_postures(find_strategy(one), self.phantom, self.robot_from_ct, self.sizes)
            for one in SEPARATE
        }

    def separate(self, strategy: str) -> PlannedLooks:
        """Plan a strategy whose targets have looks of their own, or one set of looks. Raises STU-010."""
        planned = self.postures[strategy]
        count = len(self.spheres_mm)
        numbers = np.arange(planned.sets * count)
        return PlannedLooks(
            planned.localizations.joints_rad,
            planned.arrival,
            numbers % count,
            tuple((0, int(number)) for number in numbers // count),
            tuple(
                planned.set_of(target) * count + np.arange(count) for target in range(len(self.targets_mm))
            ),
            planned.targets,
            planned.target_arrival,
        )

    def candidates(self) -> PlannedLooks:
        """Plan the poses of all strategies at each target's free angle, all used for all. Raises STU-010."""
        planned = self.postures[DEFAULT_STRATEGY]
        found, sides, draws = [], [], []
        for (kind, strategy), (target, trajectory) in product(
            enumerate(CANDIDATES), enumerate(planned.trajectories)
        ):
            joints = plan_candidates(strategy, trajectory, self.phantom, self.robot_from_ct, self.sizes)
            if joints is not None:
                found.append(joints)
                sides.append(np.tile(planned.target_arrival[target], (len(joints), 1)))
                draws += [(kind, target)] * len(joints)
        spheres = np.tile(np.arange(len(self.spheres_mm)), len(found))
        every = np.arange(len(spheres))
        return PlannedLooks(
            np.concatenate(found),
            np.concatenate(sides),
            spheres,
            tuple(draws),
            (every,) * len(self.targets_mm),
            planned.targets,
            planned.target_arrival,
        )

    def choose(self, candidates: PlannedLooks, count: int) -> PlannedLooks:
        """Choose the looks of `learning` at the first spheres, at most as many as `ocs` takes."""
        few = candidates.of_spheres(count)
        points, targets = self.spheres_mm[few.spheres], self.targets_mm
        noise_mm2 = REPEATABILITY_MM**2 + SERVO_MM**2 / AXES
        chosen = choose_looks(
            Candidates(
                few.spheres.tolist(),
                points,
                np.full(len(points), LOOK_WITH_WAY_S),
                unit_errors(ARM.chain, few.joints_rad, points, self.sizes, few.arrival),
                np.tile(np.eye(AXES) * self.ct_mm**2 / AXES, (count, 1, 1)),
                np.eye(AXES) * noise_mm2,
            ),
            targets,
            unit_errors(ARM.chain, few.targets.joints_rad, targets, self.sizes, few.target_arrival),
            count * len(targets),
        )
        return few.only(np.array(chosen.candidates, dtype=np.intp)).in_order()

    def sources(
        self, looks: PlannedLooks, used: NDArray[np.intp], targets: Sequence[int]
    ) -> tuple[Array, list[TargetSources]]:
        """Return the points (m, 3) mm of the looks that targets share, and the sources at each target."""
        points = self.spheres_mm[looks.spheres[used]]
        return points, [self._sources(looks, used, target) for target in targets]

    def _sources(self, looks: PlannedLooks, used: NDArray[np.intp], target: int) -> TargetSources:
        spheres = looks.spheres[used]
        listed = arm_sources(
            ARM.chain,
            ArmPoses(looks.joints_rad[used], self.spheres_mm[spheres], looks.arrival[used]),
            ArmPoses(
                looks.targets.joints_rad[[target]], self.targets_mm[[target]], looks.target_arrival[[target]]
            ),
            self.sizes,
        )
        ct = ct_errors(np.tile(np.eye(AXES) * self.ct_mm**2 / AXES, (len(spheres), 1, 1)))
        arm: list[Source] = [one for one in listed if one.source != SERVO]
        others: list[Source] = [one for one in listed if one.source == SERVO]
        return TargetSources(self.targets_mm[target], arm, [*others, share_by_sphere(ct, spheres.tolist())])


def join(chosen: Sequence[PlannedLooks]) -> PlannedLooks:
    """Join the looks of the plans chosen for each target, every target with its own."""
    parts = [one.only(one.used[target]) for target, one in enumerate(chosen)]
    ends = np.cumsum([0, *(len(one.spheres) for one in parts)])
    joints = np.concatenate([one.targets.joints_rad[[target]] for target, one in enumerate(chosen)])
    return PlannedLooks(
        np.concatenate([one.joints_rad for one in parts]),
        np.concatenate([one.arrival for one in parts]),
        np.concatenate([one.spheres for one in parts]),
        tuple((0, target) for target, one in enumerate(parts) for _ in one.spheres),
        tuple(np.arange(start, end) for start, end in pairwise(ends)),
        PlannedPoses.of(ARM, TOOL_MM, joints),
        np.concatenate([one.target_arrival[[target]] for target, one in enumerate(chosen)]),
    )
