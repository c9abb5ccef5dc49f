"""Localization strategies on arms as `ronna-arm calibrate` identifies them, and what remains unknown.

A trial is arm x position of the phantom x target x strategy x number of spheres, with a fine CT. Each arm is
identified once, at the phantom's first position, and used at all positions.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arm.error_budget import ErrorSizes, IdentifiedArm
from studies.accuracy.identified import LOOKS, BelievedArm, identified, identified_errors
from studies.accuracy.phantom import Markers, phantom, place
from studies.accuracy.random_arms import RandomArms, drawn_arm
from studies.accuracy.scenarios import FINE_CT_MM
from studies.accuracy.scene import Scene
from studies.accuracy.trials import Sizes
from studies.campaign import bounds
from studies.campaign.plots import boxes
from studies.campaign.table import Table
from studies.campaign.unit import Sums, Unit, blocks
from studies.strategies.study import DEPTHS_MM, PLACES, TARGETS

STRATEGIES = ("nos", "ocs", "jdms", "improved")
BLOCK_ARMS = 10
CELL, ARM, PREDICTED = "arms", "arm", "predicted"
# Assumed when choosing poses: tool frame and arm known to about a tenth.
EXPECTED = ErrorSizes(tool_mm=0.1, links=0.1, joints=0.1, backlash=0.1)
GOAL_MM = 0.13
HIGHEST = 99.0  # per cent


@dataclass(frozen=True)
class IdentifiedStudy:
    """`arms` random arms of parameter set S, each identified and then used at all positions."""

    arms: int = 100
    seed: int = 0
    name: str = "strategies-identified"

    def settings(self) -> dict[str, object]:
        """Everything the results depend on."""
        return {**asdict(self), "places": PLACES, "targets": TARGETS, "looks": LOOKS, "ct_mm": FINE_CT_MM}

    def units(self) -> Sequence[Unit]:
        """Blocks of arms."""
        return blocks(CELL, self.arms, BLOCK_ARMS)

    def run(self, unit: Unit) -> Sums:
        """Length of every error in mm: strategy|spheres|arm|place|target; per arm: arm|number|what.

        Predicted, as sums: predicted|strategy|spheres|inside, rms2.
        """
        drawn = phantom(Markers.FREE, DEPTHS_MM, TARGETS)
        scenes = [Scene.of(self.seed, drawn, Markers.FREE, number) for number in range(1, PLACES + 1)]
        planned = {
            (scene.number, strategy): scene.planned(strategy, EXPECTED)
            for scene in scenes
            for strategy in STRATEGIES
        }
        spheres = place(1).apply(drawn.spheres_mm)
        first = unit.block * BLOCK_ARMS
        found: Sums = defaultdict(float)
        for number in range(first, first + unit.runs):
            fit = identified(self.seed, number, spheres)
            apart_rad = fit.deviations.backlash_rad - np.array(drawn_arm(self.seed, number)[0].backlash_rad)
            found[f"{ARM}|{number}|backlash2"] = float(np.mean(np.degrees(apart_rad) ** 2))
            found[f"{ARM}|{number}|scatter"] = fit.scatter_mm
            believed = BelievedArm(fit.deviations, fit.flange_from_tool)
            arm = RandomArms.draw(self.seed, [number])
            known = IdentifiedArm(fit.remaining, fit.deviations.backlash_rad, fit.scatter_mm)
            left = ErrorSizes(identified=known)
            for scene in scenes:
                for strategy in STRATEGIES:
                    poses = planned[scene.number, strategy]
                    errors = identified_errors(arm, believed, poses, scene, [number], Sizes(FINE_CT_MM))
                    predicted = scene.predicted(poses, left, FINE_CT_MM)
                    for (target, count), length in np.ndenumerate(np.linalg.norm(errors, axis=-1)):
                        series = f"{strategy}|{scene.counts[count]}"
                        found[f"{series}|{number}|{scene.number}|{target + 1}"] = float(length)
                        one = predicted[count][target]
                        found[f"{PREDICTED}|{series}|inside"] += float(one.holds(errors[target, count]))
                        found[f"{PREDICTED}|{series}|rms2"] += one.rms_mm**2
        return dict(found)


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Errors at the targets, and what identification leaves."""
    errors = _errors(sums)
    arms, predicted = defaultdict(list), defaultdict[str, float](float)
    for content in sums.values():
        for key, value in content.items():
            if key.startswith(f"{ARM}|"):
                arms[key.split("|")[2]].append(value)
            elif key.startswith(f"{PREDICTED}|"):
                predicted[key] += value
    return [
        Table(
            "Arms as they are identified",
            (
                "strategy",
                "spheres",
                "trials",
                "mean mm",
                bounds.column("mean"),
                f"{HIGHEST:.0f} % below",
                "largest mm",
                "goal mm",
            ),
            [
                [
                    strategy,
                    count,
                    each.size,
                    float(np.mean(each)),
                    bounds.mean_length(each.mean(axis=1)).text,
                    float(np.percentile(each, HIGHEST)),
                    float(np.max(each)),
                    GOAL_MM,
                ]
                for (strategy, count), each in errors.items()
            ],
            f"Set S, free spheres, CT {FINE_CT_MM} mm. Each arm identified from {LOOKS} "
            f"measurements of the phantom's spheres. {bounds.CAPTION}: of the mean, from the "
            "scatter of the arms (Student).",
        ),
        Table(
            "Predicted and actual error",
            ("strategy", "spheres", "trials", "inside 95 % region %", "predicted rms mm", "actual rms mm"),
            [
                [
                    strategy,
                    count,
                    each.size,
                    100.0 * predicted[f"{PREDICTED}|{strategy}|{count}|inside"] / each.size,
                    float(np.sqrt(predicted[f"{PREDICTED}|{strategy}|{count}|rms2"] / each.size)),
                    float(np.sqrt(np.mean(each**2))),
                ]
                for (strategy, count), each in errors.items()
            ],
            "The prediction knows the covariance that the identification of each arm has left.",
        ),
        Table(
            "What the identification leaves",
            ("arms", "backlash deg rms", "random error mm per axis"),
            [
                [
                    len(arms["scatter"]),
                    float(np.sqrt(np.mean(arms["backlash2"]))),
                    float(np.mean(arms["scatter"])),
                ]
            ],
            "Backlash of set S is 0.02 deg. The random error is estimated from the measurements themselves.",
        ),
    ]


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    """A box for each strategy and number of spheres."""
    groups = {f"{strategy} {count}": each.ravel() for (strategy, count), each in _errors(sums).items()}
    return {"strategies-identified.png": boxes("Error at the target, identified arms", "mm", groups)}


def _errors(sums: Mapping[str, Sums]) -> dict[tuple[str, int], NDArray[np.float64]]:
    """Errors (arms, trials) in mm."""
    found: dict[tuple[str, int], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for content in sums.values():
        for key, error_mm in content.items():
            strategy, count, arm, *_ = key.split("|")
            if strategy in STRATEGIES:
                found[strategy, int(count)][arm].append(error_mm)
    ordered = sorted(found.items(), key=lambda one: (STRATEGIES.index(one[0][0]), one[0][1]))
    return {series: np.array(list(arms.values())) for series, arms in ordered}
