"""The error at the target on random arms: its two parts, and what does and does not tell its size.

The parts are those of eq. 40 to 42 of the thesis: the registered target minus the true one, and the reached
one minus the registered. Beside them the residual FRE of the registration, the distance from the markers and
the travel of the joints between markers and target (4.2). Arms of parameter set S, five free spheres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np

from ronna_hw.arrays import Array
from studies.accuracy.phantom import FREE_SPHERES, Markers, draw_phantom, phantom_pose
from studies.accuracy.postures import Postures
from studies.accuracy.random_arms import RandomArms
from studies.accuracy.scene import DIGITS, Sizes, StudiedScene
from studies.campaign import bounds
from studies.campaign.plots import scatters
from studies.campaign.study import Cell, Study, Sums, Table, Unit, blocks_of_each
from studies.strategies.study import DEPTHS_MM, PLACES, TARGETS

STRATEGIES = ("nos", "thesis-ocs", "ocs", "jdms", "improved")
BLOCK_ARMS = 125
THIRDS = 3
FRE, REGISTRATION, ARM, ERROR, ALIGNED = "fre", "registration", "arm", "error", "aligned"
OF_TRIALS = (FRE, REGISTRATION, ARM, ERROR, ALIGNED)
DISTANCE, TRAVEL = "distance", "travel"


@dataclass(frozen=True)
class ErrorPartsStudy(Study):
    """Study of `arms` random arms, each at all positions and targets with every strategy."""

    arms: int = 40
    seed: int = 0
    name: str = "error-parts"

    constants: ClassVar = {"places": PLACES, "targets": TARGETS, "strategies": list(STRATEGIES)}

    def units(self) -> Sequence[Unit]:
        return blocks_of_each(product(STRATEGIES, range(1, PLACES + 1)), self.arms, BLOCK_ARMS)

    def run(self, unit: Unit) -> Sums:
        """Return FRE, both parts and the error in mm of every trial, keyed `what|arm|target`.

        `aligned` is the cosine between the parts. Of every target: distance in mm and travel in rad, keyed
        `what|target`.
        """
        strategy, number = unit.condition.split("|")
        first = unit.block * BLOCK_ARMS
        arms = range(first, first + unit.runs)
        phantom = draw_phantom(Markers.FREE, DEPTHS_MM, TARGETS)
        scene = StudiedScene(
            self.seed, Markers.FREE, int(number), phantom, phantom_pose(int(number)), (FREE_SPHERES,)
        )
        planned = scene.planned(strategy)
        reached = scene.reach_targets(RandomArms.draw(self.seed, arms), planned, scene.chance(arms), Sizes())
        registered_mm, error_mm = reached.registered_mm[:, :, 0], reached.reached_mm[:, :, 0]
        arm_mm = error_mm - registered_mm
        lengths = [np.linalg.norm(one, axis=-1) for one in (registered_mm, arm_mm, error_mm)]
        aligned = (registered_mm * arm_mm).sum(axis=-1) / (lengths[0] * lengths[1])
        found: Sums = {}
        of_trials = zip(OF_TRIALS, (reached.fre_mm[:, :, 0], *lengths, aligned), strict=True)
        for what, values in of_trials:
            for (arm, target), value in np.ndenumerate(values):
                found[f"{what}|{arms[arm]}|{target}"] = round(float(value), DIGITS)
        if unit.block == 0:  # the same for all arms, and sums of all blocks are added
            spheres = scene.robot_from_ct.apply(phantom.spheres_mm)
            targets = scene.robot_from_ct.apply([one.target_mm for one in phantom.trajectories])
            away_mm = np.linalg.norm(targets - spheres.mean(axis=0), axis=1)
            found |= {f"{DISTANCE}|{target}": float(value) for target, value in enumerate(away_mm)}
            found |= {f"{TRAVEL}|{target}": joint_travel_rad(planned, target) for target in range(TARGETS)}
        return found


def joint_travel_rad(planned: Postures, target: int) -> float:
    """Return the mean length of the joints' way from the spheres to a target, as a vector of six angles."""
    first = planned.set_of(target) * FREE_SPHERES
    looks = planned.localizations.joints_rad[first : first + FREE_SPHERES]
    return float(np.linalg.norm(looks - planned.targets.joints_rad[target], axis=1).mean())


@dataclass(frozen=True)
class Trials:
    """All trials of a strategy: values (arms, targets) by name, with distance and travel of every target."""

    of_trials: Mapping[str, Array]
    distance_mm: Array
    travel_deg: Array

    @property
    def error_mm(self) -> Array:
        return self.of_trials[ERROR]


def collect(sums: Mapping[str, Sums]) -> dict[str, Trials]:
    """Collect the trials of each strategy from all positions."""
    found: dict[str, dict[str, list[Array]]] = {}
    for condition, content in sums.items():
        of_strategy = found.setdefault(condition.split("|")[0], {})
        arms = sorted({int(key.split("|")[1]) for key in content if key.startswith(f"{FRE}|")})
        for what in OF_TRIALS:
            rows = [[content[f"{what}|{arm}|{target}"] for target in range(TARGETS)] for arm in arms]
            of_strategy.setdefault(what, []).append(np.array(rows))
        for what in (DISTANCE, TRAVEL):
            of_strategy.setdefault(what, []).append(
                np.array([content[f"{what}|{target}"] for target in range(TARGETS)])
            )
    return {
        strategy: Trials(
            {what: np.concatenate(values[what], axis=1) for what in OF_TRIALS},
            np.concatenate(values[DISTANCE]),
            np.degrees(np.concatenate(values[TRAVEL])),
        )
        for strategy, values in found.items()
    }


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    trials = collect(sums)
    return [
        Table.of(
            "Registration and arm in the error at the target",
            [_parts_row(strategy, one) for strategy, one in trials.items()],
            "Mean lengths of registered minus true, reached minus registered, and their sum, reached minus "
            "true (eq. 40 to 42). Independent parts would add up to the root of the sum of squares. "
            f"Cosine: mean of that between the two; -1 where they cancel. {bounds.CAPTION}: over the arms.",
        ),
        Table.of(
            "FRE against the error at the target",
            [_fre_row(strategy, one) for strategy, one in trials.items()],
            "Pearson's correlation r. Within an arm: over its positions and targets, mean over the arms. "
            "Between arms: at the same position and target, mean over those; the larger errors of some arms "
            f"are in both. {bounds.CAPTION}: Student, over arms.",
        ),
        Table.of(
            "Error against distance and joint travel",
            [row for strategy, one in trials.items() for row in _way_rows(strategy, one)],
            "Rms over the arms at each position and target. Distance: from the centroid of the spheres. "
            "Travel: mean length of the six joints' way from a sphere to the target. "
            f"{bounds.CAPTION} of r: Fisher, as for independent targets.",
        ),
    ]


def _parts_row(strategy: str, trials: Trials) -> dict[str, Cell]:
    means = {what: values.mean(axis=1) for what, values in trials.of_trials.items()}
    independent = np.hypot(trials.of_trials[REGISTRATION], trials.of_trials[ARM])
    return {
        "strategy": strategy,
        "trials": trials.error_mm.size,
        **bounds.cells("registration mm", bounds.mean_length(means[REGISTRATION])),
        **bounds.cells("arm mm", bounds.mean_length(means[ARM])),
        **bounds.cells("error mm", bounds.mean_length(means[ERROR])),
        "if independent mm": float(independent.mean()),
        "cosine": float(means[ALIGNED].mean()),
    }


def _fre_row(strategy: str, trials: Trials) -> dict[str, Cell]:
    fre_mm, error_mm = trials.of_trials[FRE], trials.error_mm
    within = [bounds.correlation(*pair).value for pair in zip(fre_mm, error_mm, strict=True)]
    between = [bounds.correlation(*pair).value for pair in zip(fre_mm.T, error_mm.T, strict=True)]
    return {
        "strategy": strategy,
        "trials": error_mm.size,
        "FRE mm": float(fre_mm.mean()),
        "error mm": float(error_mm.mean()),
        "r of all": bounds.correlation(fre_mm.ravel(), error_mm.ravel()).value,
        **bounds.cells("r within an arm", bounds.mean(within), of="r within an arm"),
        "r between arms": float(np.mean(between)) if len(fre_mm) > 1 else None,
    }


def _way_rows(strategy: str, trials: Trials) -> list[dict[str, Cell]]:
    rms_mm = np.sqrt(np.square(trials.error_mm).mean(axis=0))
    rows: list[dict[str, Cell]] = []
    for name, values in (("distance mm", trials.distance_mm), ("travel deg", trials.travel_deg)):
        parts = np.array_split(np.argsort(values, kind="stable"), THIRDS)
        rows.append(
            {
                "strategy": strategy,
                "against": name,
                "targets": len(values),
                "least": float(values.min()),
                "most": float(values.max()),
                **bounds.cells("r", bounds.correlation(values, rms_mm)),
                **{
                    f"rms mm, {third} third": float(np.sqrt(np.square(rms_mm[part]).mean()))
                    for third, part in zip(("least", "middle", "most"), parts, strict=True)
                },
            }
        )
    return rows


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    trials = collect(sums)
    fre = {name: (one.of_trials[FRE].ravel(), one.error_mm.ravel()) for name, one in trials.items()}
    rms_mm = {name: np.sqrt(np.square(one.error_mm).mean(axis=0)) for name, one in trials.items()}
    return {
        "fre-and-error.png": scatters(
            "FRE and the error at the target", "FRE, mm", "error at the target, mm", fre
        ),
        "error-and-distance.png": scatters(
            "Error against the distance from the markers",
            "target from the centroid of the spheres, mm",
            "rms error at the target, mm",
            {name: (one.distance_mm, rms_mm[name]) for name, one in trials.items()},
        ),
        "error-and-travel.png": scatters(
            "Error against joint travel",
            "way of the joints from a sphere to the target, deg",
            "rms error at the target, mm",
            {name: (one.travel_deg, rms_mm[name]) for name, one in trials.items()},
        ),
    }
