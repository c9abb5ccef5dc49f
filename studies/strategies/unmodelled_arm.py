"""Predicted target error on arms with effects that their model lacks, and with a tracker that distorts.

A trial is arm x target x number of spheres. Every arm has a position of the phantom and a strategy of its
own: arms differ more than trials of one. It has one effect at a time, during its calibration too unless
something is bumped or moved later. It is used uncalibrated and as identified. What a case checks is checked:
the calibration's own validation, the residual gate (PRO-007) and the guide on its gauge before and after
every target (TOOL-005). A trial that fails one is refused. All others are accepted: a laboratory would go on
with them. They are judged by the 95 % limit that the operator would see, shares for unnoticed changes
included.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm_calibration import identify, validate
from procedures.calibration.arm_model import ArmModel, LookArrays
from procedures.guards.stability import GUIDE_NOTICEABLE_MM
from procedures.registration.rigid_fit import fit_rigid
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.deviations import ArmDeviations
from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED, UNCALIBRATED_MM, ErrorSizes, IdentifiedArm
from ronna_hw.errors import RonnaError
from sim.world.true_arm import TrueArm
from studies.accuracy.phantom import Markers, draw_phantom, phantom_pose
from studies.accuracy.postures import ARM, TOOL, Postures
from studies.accuracy.random_arms import RandomArms, draw_numbered_arm
from studies.accuracy.scene import AXES, FINE_CT_MM, Sizes, StudiedScene
from studies.accuracy.unmodelled_effects import AFTER_CALIBRATION, DisplacedArms, DrawnEffect, Effect
from studies.campaign.study import Study, Sums, Unit, blocks
from studies.strategies import distorted_tracker
from studies.strategies.identified import (
    EXPECTED,
    BelievedArm,
    IdentifiedCase,
    measure_looks,
    plan_arm_looks,
)
from studies.strategies.judged_arm import RESIDUAL, JudgedArm, predict, refusing_gates, without_unnoticed
from studies.strategies.study import DEPTHS_MM, TARGETS

STRATEGIES = ("nos", "ocs", "improved")
PLACES = (1, 2)
BLOCK_ARMS = 10
ARMS, MOVES = "arms", "moves"
CALIBRATED, UNCALIBRATED_ARM = "calibrated", "uncalibrated"
VALIDATION = 20  # measurements held out from the identification
BUMP_KEY = 12  # of the random numbers
# Time in motion: a look with its approach, the way to the gauge, the way to a target and back to the gauge.
LOOK_S, GAUGE_S, TARGET_S = 10.0, 60.0, 20.0
DIAL_MM = 0.01  # of a gauge, per reading
READINGS = 6
GAUGE = "TOOL-005"
EVERY_COUNT = "all"  # numbers of spheres, of what is counted by arm


@dataclass(frozen=True)
class UnmodelledArmStudy(Study):
    """Study of `arms` random arms of set S with every effect, and of followed moves with a wrong tracker."""

    arms: int = 200
    seed: int = 0
    effects: tuple[Effect, ...] = tuple(Effect)
    name: str = "strategies-wrong"

    constants: ClassVar = {"places": list(PLACES), "targets": TARGETS, "ct_mm": FINE_CT_MM}

    def units(self) -> Sequence[Unit]:
        """List blocks of arms, then one unit of moves for each kind of tracker."""
        moves = [Unit(f"{MOVES}|{one}", 0, distorted_tracker.RUNS) for one in distorted_tracker.Tracker]
        return [*blocks(ARMS, self.arms, BLOCK_ARMS), *moves]

    def run(self, unit: Unit) -> Sums:
        """Return sums keyed `effect|arm|strategy|spheres|quantity`; see `distorted_tracker` for moves.

        With `EVERY_COUNT` spheres: squares and products of the arms' own sums, for bounds on their scatter.
        """
        if unit.condition != ARMS:
            tracker = distorted_tracker.Tracker(unit.condition.partition("|")[2])
            return distorted_tracker.follow_moves(tracker, self.seed, unit.runs)
        bench = _Bench.set_up(self.seed)
        sums: Counter[str] = Counter()
        for number in range(unit.block * BLOCK_ARMS, unit.block * BLOCK_ARMS + unit.runs):
            sums.update(bench.try_arm(number, self.effects))
        return dict(sums)


@dataclass(frozen=True)
class _Case:
    """Localizations, targets and gauge of one arm with one effect, with their displacements."""

    at_spheres: DisplacedArms
    at_targets: DisplacedArms
    off_gauge: NDArray[np.bool_]  # (t,) whether the gauge shows it before or after a target


@dataclass(frozen=True)
class _Bench:
    """Phantom, planned postures and planned calibration, common to all arms."""

    seed: int
    scenes: tuple[StudiedScene, ...]
    planned: Mapping[tuple[str, int, str], Postures]
    looks: LookArrays
    held_out: NDArray[np.bool_]
    spheres_mm: Array  # of the calibration
    nominal: JudgedArm

    @classmethod
    @lru_cache(maxsize=1)
    def set_up(cls, seed: int) -> _Bench:
        drawn = draw_phantom(Markers.FREE, DEPTHS_MM, TARGETS)
        scenes = tuple(StudiedScene.of(seed, drawn, Markers.FREE, number) for number in PLACES)
        spheres_mm = phantom_pose(PLACES[0]).apply(drawn.spheres_mm)
        planned = {
            (kind, scene.number, strategy): scene.planned(strategy, sizes)
            for kind, sizes in ((CALIBRATED, EXPECTED), (UNCALIBRATED_ARM, UNCALIBRATED))
            for scene in scenes
            for strategy in STRATEGIES
        }
        looks, held_out = plan_arm_looks(ArmModel(ARM, TOOL), spheres_mm, VALIDATION)
        believed = BelievedArm(ArmDeviations.none(len(ARM.chain.joints)), TOOL)
        nominal = JudgedArm(believed, UNCALIBRATED, UNCALIBRATED_MM)
        return cls(seed, scenes, planned, looks, held_out, spheres_mm, nominal)

    def try_arm(self, number: int, effects: Sequence[Effect]) -> Counter[str]:
        sums: Counter[str] = Counter()
        scene = self.scenes[number % len(self.scenes)]
        strategy = STRATEGIES[number // len(self.scenes) % len(STRATEGIES)]
        known: dict[Effect, JudgedArm | RonnaError] = {}
        for effect in effects:
            at_calibration = Effect.NOTHING if effect in AFTER_CALIBRATION else effect
            if at_calibration not in known:
                known[at_calibration] = self._calibrate(number, at_calibration)
            for kind, judged in (
                (UNCALIBRATED_ARM, self.nominal),
                (CALIBRATED, known[at_calibration]),
            ):
                tried = self._try_case(
                    number, effect, scene, self.planned[kind, scene.number, strategy], judged
                )
                sums.update({f"{effect}|{kind}|{strategy}|{name}": value for name, value in tried.items()})
        return sums

    def _calibrate(self, number: int, effect: Effect) -> JudgedArm | RonnaError:
        """Identify and validate an arm with an effect as `ronna-arm calibrate` does; return any refusal."""
        drawn = DrawnEffect.draw(effect, self.seed, number)
        looks, true = self.looks, TrueArm(draw_numbered_arm(self.seed, number)[0], number)
        in_turn = np.argsort(np.argsort(looks.sphere, kind="stable"))  # sphere by sphere
        moved_s: Array = LOOK_S * (1.0 + in_turn.astype(float))
        shift_rad = drawn.shift_rad(ARM.chain, looks.joints_rad, self.spheres_mm[looks.sphere], moved_s)
        shift_mm = drawn.shift_mm(moved_s)

        def at_rest(joints: Sequence[float], flanks: Sequence[float], row: int) -> Array:
            flange = true.at_rest(np.add(joints, shift_rad[row]).tolist(), flanks, row).copy()
            flange[:3, 3] += shift_mm[row]
            return flange

        seen = measure_looks(looks, self.seed, number, self.spheres_mm, at_rest)
        try:
            fit = identify(ArmModel(ARM, TOOL), seen.only(~self.held_out))
            stated_mm = validate(fit, seen.only(self.held_out)).model_mm
        except RonnaError as refusal:
            return refusal
        known = fit.remaining, fit.deviations.backlash_rad, fit.scatter_mm, fit.freedom
        per_axis_mm = stated_mm / np.sqrt(AXES)
        return JudgedArm(
            BelievedArm(fit.deviations, fit.flange_from_tool),
            ErrorSizes(tool_mm=per_axis_mm, identified=IdentifiedArm(*known)),
            float(np.sqrt(2.0) * per_axis_mm),
        )

    def _try_case(
        self,
        number: int,
        effect: Effect,
        scene: StudiedScene,
        planned: Postures,
        judged: JudgedArm | RonnaError,
    ) -> Sums:
        """Localize, register and reach all targets once; sums by number of spheres."""
        if isinstance(judged, RonnaError):
            counted = "trials", judged.code
            return {f"{count}|{name}": float(TARGETS) for count in scene.counts for name in counted}
        case = self._place_case(number, effect, scene, planned)
        sizes = Sizes(FINE_CT_MM)
        looked = IdentifiedCase(case.at_spheres, judged.believed, planned, scene, [number])
        reached = replace(looked, arm=case.at_targets)
        image, recorded = looked.record_spheres_mm(sizes)
        recorded[:, 0] += DrawnEffect.draw(effect, self.seed, number).moved_mm
        sums: dict[str, float] = defaultdict(float)
        for count in scene.counts:
            fit = fit_rigid(image[None, :count], recorded[:, :count])
            errors = reached.reach_targets_mm(fit)
            refused = [
                refusing_gates(
                    image[:count],
                    recorded[nth, :count],
                    fit,
                    nth,
                    judged.allowed(scene, planned, nth, count),
                )
                for nth in range(planned.sets)
            ]
            for target, error_mm in enumerate(np.linalg.norm(errors, axis=1).tolist()):
                gates = refused[planned.set_of(target)]
                sums[f"{count}|trials"] += 1
                for name in gates - {RESIDUAL}:
                    sums[f"{count}|{name}"] += 1
                if RESIDUAL in gates:
                    sums[f"{count}|{RESIDUAL}"] += 1
                elif case.off_gauge[target]:
                    sums[f"{count}|{GAUGE}"] += 1
                else:
                    own = recorded[planned.set_of(target)]
                    predicted = predict(scene, planned, target, count, judged, image, own, fit)
                    stated = replace(predicted, widening=1.0)
                    sums[f"{count}|used"] += 1
                    sums[f"{count}|error"] += error_mm
                    sums[f"{count}|limit"] += predicted.limit_mm()
                    sums[f"{count}|inside"] += error_mm <= predicted.limit_mm()
                    sums[f"{count}|inside stated"] += error_mm <= stated.limit_mm()
                    sums[f"{count}|inside seen"] += error_mm <= without_unnoticed(predicted).limit_mm()
                    sums[f"{count}|widened"] += predicted.widening > 1.0
        return {**sums, **_squares_of_arm(sums)}

    def _place_case(self, number: int, effect: Effect, scene: StudiedScene, planned: Postures) -> _Case:
        """Displace an arm at all poses of a case, in the order in which a case takes them."""
        arm = RandomArms.draw(self.seed, [number])
        drawn, chain = DrawnEffect.draw(effect, self.seed, number), ARM.chain
        random = np.random.default_rng([self.seed, BUMP_KEY, number, scene.number])
        spheres = np.tile(scene.robot_from_ct.apply(scene.phantom.spheres_mm), (planned.sets, 1))
        targets = scene.robot_from_ct.apply([one.target_mm for one in scene.phantom.trajectories])
        at_spheres, at_targets = planned.localizations, planned.targets
        looked_s: Array = LOOK_S * (1.0 + np.arange(len(spheres), dtype=float))
        gauged_s: Array = looked_s[-1] + GAUGE_S + TARGET_S * np.arange(TARGETS + 1, dtype=float)
        reached_s: Array = gauged_s[:-1] + 0.5 * TARGET_S
        first = {Effect.BUMP_BEFORE: 0, Effect.BUMP_DURING: int(random.integers(1, len(spheres)))}
        is_bumped = np.arange(len(spheres)) >= first.get(effect, len(spheres))
        # The gauge is read where the guide's tip was calibrated, cold and before any bump.
        read_s, read_bumped = np.concatenate([[0.0], gauged_s]), np.arange(TARGETS + 2) > 0
        joints, place = (
            np.tile(at_targets.joints_rad[0], (TARGETS + 2, 1)),
            np.tile(targets[0], (TARGETS + 2, 1)),
        )
        flanks = np.tile(planned.target_arrival[0], (TARGETS + 2, 1))

        def displaced(
            joints: Array, points: Array, moved_s: Array, bumped: NDArray[np.bool_], turn: Array
        ) -> DisplacedArms:
            bumps = bumped[:, None] * (turn @ drawn.bump_mm)
            shift_rad = drawn.shift_rad(chain, joints, points, moved_s)
            return DisplacedArms.at(arm, shift_rad, drawn.shift_mm(moved_s) + bumps)

        on_gauge = displaced(joints, place, read_s, read_bumped, at_targets.rotations[0])
        read = on_gauge.tool_points_mm(joints[None], flanks[None])[0]
        noise_mm = np.hypot(arm.repeatability_mm, DIAL_MM) / np.sqrt(READINGS)
        off = read[1:] - read[0] + noise_mm * random.normal(size=(TARGETS + 1, AXES))
        is_off = np.linalg.norm(off, axis=1) > GUIDE_NOTICEABLE_MM
        return _Case(
            displaced(at_spheres.joints_rad, spheres, looked_s, is_bumped, at_spheres.rotations),
            displaced(
                at_targets.joints_rad, targets, reached_s, np.ones(TARGETS, dtype=bool), at_targets.rotations
            ),
            is_off[:-1] | is_off[1:],
        )


def _squares_of_arm(sums: Mapping[str, float]) -> Sums:
    """Return the squares and products of an arm's own sums over all numbers of spheres."""
    total: dict[str, float] = defaultdict(float)
    for key, value in sums.items():
        total[key.partition("|")[2]] += value
    used, inside = total["used"], total["inside"]
    found = {
        "arms used": float(used > 0),
        "used2": used**2,
        "inside2": inside**2,
        "inside used": inside * used,
    }
    return {f"{EVERY_COUNT}|{name}": float(value) for name, value in found.items()}
