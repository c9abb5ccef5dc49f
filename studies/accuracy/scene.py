"""The phantom in one position: strategies run there on random arms, in scenarios of calibration and CT."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from procedures.calibration.arm_sources import ArmPoses, arm_sources, ct_errors
from procedures.registration.target_prediction import TargetPrediction, predict_target_error
from procedures.strategies.catalogue import CANDIDATES, strategy_named
from procedures.strategies.strategy import Strategy
from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED, ErrorSizes
from ronna_hw.frames import Transform
from sim.world.scene.as_built import (
    BACKLASH_RAD,
    JOINT_OFFSET_RAD,
    LINK_ROTATION_RAD,
    LINK_TRANSLATION_MM,
    TOOL_ERROR_MM,
)
from sim.world.scene.model import ArmResidual
from studies.accuracy.phantom import Markers, Phantom, counts_of, phantom_pose
from studies.accuracy.postures import ARM, Postures, plan_postures
from studies.accuracy.random_arms import RandomArms
from studies.accuracy.trials import AXES, CT_FLE_MM, Chance, Sizes, target_errors
from studies.campaign.study import Sums

CALIBRATED = ArmResidual()
# Backlash as known after calibration: twice the error that `ronna-campaign strategies --identified` finds.
CALIBRATED_BACKLASH_RAD = float(np.radians(0.0015))
FINE_CT_MM = 0.05  # 3-D rms
ANY_APPROACH = "thesis-ocs"
Array = NDArray[np.float64]
DIGITS = 6  # of an error in mm
BEST = "best"  # per target and number of spheres, the strategy with the smallest predicted error
FROM = tuple(one.name for one in CANDIDATES)


def predict_targets(
    planned: Postures,
    phantom: Phantom,
    robot_from_ct: Transform,
    count: int,
    left: ErrorSizes = UNCALIBRATED,
    ct_mm: float = CT_FLE_MM,
) -> list[TargetPrediction]:
    """Predict the error at each target with the first `count` spheres; the fit is unweighted."""
    spheres = robot_from_ct.apply(phantom.spheres_mm)
    found = []
    for number, trajectory in enumerate(phantom.trajectories):
        first = planned.set_of(number) * len(spheres)
        looks = slice(first, first + count)
        target = robot_from_ct.apply(trajectory.target_mm)
        at_spheres = ArmPoses(
            planned.localizations.joints_rad[looks], spheres[:count], planned.arrival[looks]
        )
        at_target = ArmPoses(
            planned.targets.joints_rad[[number]], target[None], planned.target_arrival[[number]]
        )
        ct = np.tile(np.eye(AXES) * ct_mm**2 / AXES, (count, 1, 1))
        sources = [*arm_sources(ARM.chain, at_spheres, at_target, left), ct_errors(ct)]
        found.append(predict_target_error(spheres[:count], target, sources))
    return found


@dataclass(frozen=True)
class Scenario:
    """Parts of the arm that are calibrated, and the CT error (3-D rms).

    The levels are those assumed for a calibrated arm; harmonics and sag are those of set S, and so is
    backlash unless it is `known`. Without control of the approach, the side of a joint is never known.
    """

    name: str
    tool: bool = False
    kinematics: bool = False
    known: bool = False  # the backlash, to CALIBRATED_BACKLASH_RAD
    ct_mm: float = CT_FLE_MM

    @property
    def sizes(self) -> Sizes:
        """The errors outside the arm."""
        return Sizes(ct_mm=self.ct_mm)

    def left(self, strategy: str) -> ErrorSizes:
        """The remaining errors of the arm."""
        return replace(
            UNCALIBRATED,
            tool_mm=CALIBRATED.tool_mm if self.tool else TOOL_ERROR_MM,
            links=CALIBRATED.angle_rad / LINK_ROTATION_RAD if self.kinematics else 1.0,
            backlash=self._backlash_left(strategy),
        )

    def _backlash_left(self, strategy: str) -> float:
        known = self.known and strategy != ANY_APPROACH
        return CALIBRATED_BACKLASH_RAD / BACKLASH_RAD if known else 1.0

    def of(self, arms: RandomArms, strategy: str) -> RandomArms:
        """Scale the arms' errors down to the part that remains for a strategy once calibrated."""
        arms = replace(arms, backlash_rad=arms.backlash_rad * self._backlash_left(strategy))
        if self.tool:
            arms = replace(arms, tool_error_mm=arms.tool_error_mm * CALIBRATED.tool_mm / TOOL_ERROR_MM)
        if not self.kinematics:
            return arms
        turns = Rotation.from_matrix(arms.link_rotation.reshape(-1, 3, 3)).as_rotvec()
        remaining = Rotation.from_rotvec(turns * CALIBRATED.angle_rad / LINK_ROTATION_RAD).as_matrix()
        return replace(
            arms,
            link_translation_mm=arms.link_translation_mm * CALIBRATED.link_mm / LINK_TRANSLATION_MM,
            link_rotation=remaining.reshape(arms.link_rotation.shape),
            joint_offset_rad=arms.joint_offset_rad * CALIBRATED.angle_rad / JOINT_OFFSET_RAD,
        )


SET_S = Scenario("set S")


SCENARIOS = (
    SET_S,
    Scenario("tool calibrated", tool=True),
    Scenario("tool and kinematics calibrated", tool=True, kinematics=True),
    Scenario("fine CT", ct_mm=FINE_CT_MM),
    Scenario("tool calibrated, fine CT", tool=True, ct_mm=FINE_CT_MM),
    Scenario("tool and kinematics calibrated, fine CT", tool=True, kinematics=True, ct_mm=FINE_CT_MM),
    Scenario("the same, backlash known too", tool=True, kinematics=True, known=True, ct_mm=FINE_CT_MM),
)


@dataclass(frozen=True)
class Outcome:
    """Error vectors (a, t, c, 3) of all arms, targets, numbers of spheres; predictions by the last two."""

    errors_mm: Array
    predicted: list[list[TargetPrediction]]


@dataclass(frozen=True)
class Scene:
    """A phantom with its markers in position `number`; `counts` spheres are used for a registration."""

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
        """Build with every number of spheres these markers allow, and user strategies besides ours."""
        return cls(seed, markers, number, phantom, phantom_pose(number), counts_of(markers), own)

    def planned(self, strategy: str, left: ErrorSizes = UNCALIBRATED) -> Postures:
        """The poses of a strategy here, for arms with these remaining errors. Raises STU-010."""
        own = {one.name: one for one in self.own}
        chosen = own.get(strategy) or strategy_named(strategy)
        return plan_postures(chosen, self.phantom, self.robot_from_ct, left)

    def predicted(
        self, planned: Postures, left: ErrorSizes = UNCALIBRATED, ct_mm: float = CT_FLE_MM
    ) -> list[list[TargetPrediction]]:
        """Predict the errors by number of spheres, then by target."""
        return [
            predict_targets(planned, self.phantom, self.robot_from_ct, count, left, ct_mm)
            for count in self.counts
        ]

    def chance(self, arms: Sequence[int], *, scan_again: bool = False) -> Chance:
        """The random draws for arms with these numbers."""
        shape = len(self.phantom.trajectories), len(self.phantom.spheres_mm)
        return Chance.draw(self.seed, self.markers, arms, self.number, shape, scan_again=scan_again)

    def errors_mm(
        self, arms: RandomArms, planned: Postures, chance: Chance, sizes: Sizes, *, any_side: bool = False
    ) -> Array:
        """Error vectors (a, t, c, 3) of all arms, targets and numbers of spheres."""
        return target_errors(
            arms, planned, self.phantom, self.robot_from_ct, chance, self.counts, sizes, any_side=any_side
        )

    def outcomes(
        self,
        strategies: Sequence[str],
        arms: RandomArms,
        chance: Chance,
        scenario: Scenario = SET_S,
        *,
        any_side: bool = False,
    ) -> dict[str, Outcome]:
        """Run the strategies on these arms of set S in a scenario, which they plan and predict for."""
        single = dict.fromkeys(
            (*(FROM if BEST in strategies else ()), *(one for one in strategies if one != BEST))
        )
        found = {}
        for one in single:
            left = scenario.left(one)
            planned, remaining = self.planned(one, left), scenario.of(arms, one)
            found[one] = Outcome(
                self.errors_mm(remaining, planned, chance, scenario.sizes, any_side=any_side),
                self.predicted(planned, left, scenario.ct_mm),
            )
        if BEST in strategies:
            found[BEST] = _best([found[one] for one in FROM])
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
        """Length of every error in mm: strategy|spheres|arm|target."""
        drawn, chance = RandomArms.draw(self.seed, arms), self.chance(arms, scan_again=scan_again)
        found: Sums = {}
        outcomes = self.outcomes(strategies, drawn, chance, scenario, any_side=any_side)
        for strategy, outcome in outcomes.items():
            lengths = np.linalg.norm(outcome.errors_mm, axis=-1)
            for (arm, target, count), length in np.ndenumerate(lengths):
                key = f"{strategy}|{self.counts[count]}|{arms[arm]}|{target + 1}"
                found[key] = round(float(length), DIGITS)
        return found


def _best(candidates: Sequence[Outcome]) -> Outcome:
    """Choose the smallest predicted error at each target for each number of spheres."""
    predicted = [one.predicted for one in candidates]
    chosen = np.array([[[each.rms_mm for each in row] for row in one] for one in predicted]).argmin(axis=0)
    errors_mm = np.stack([one.errors_mm for one in candidates])
    return Outcome(
        np.take_along_axis(errors_mm, chosen.T[None, None, :, :, None], axis=0)[0],
        [[predicted[k][count][target] for target, k in enumerate(row)] for count, row in enumerate(chosen)],
    )
