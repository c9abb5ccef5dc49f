"""Localization strategies on random arms (thesis 5.4): the protocol of table 4 on a few hundred arms.

A trial is arm x position of the phantom x target x strategy x number of spheres. Parameter set S of the arm's
errors; our own phantom. In addition to the trials: the effect of each source alone, whether predicted regions
contain the errors, and the effect of other interpretations of the protocol.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np

from studies.accuracy.phantom import ALIKE, USUAL_TILTS, Markers, draw_phantom
from studies.accuracy.random_arms import RandomArms, Source
from studies.accuracy.scene import DIGITS, SCENARIOS, SET_S, Scenario, Sizes, StudiedScene
from studies.campaign.study import Study, Sums, Unit, blocks_of_each
from studies.plugins.method import PluginMethod
from studies.plugins.strategy import PluginStrategy

STRATEGIES = ("nos", "ocs", "thesis-ocs", "jdms", "improved", "best")
BESIDE_OWN = ("nos", "ocs", "thesis-ocs", "jdms")  # the thesis' own
ALONE = STRATEGIES[:-1]  # strategies with poses of their own
PLACES, TARGETS = 8, 10
DEPTHS_MM = (30.0, 120.0)
BLOCK_ARMS = 125
MOST_ARMS_OF_SOURCES = 40  # enough for a mean
MOST_ARMS_OF_OTHERS = 100  # and for a 99 % quantile
ARMS_OF_PREDICTION = 125  # at each of the eight positions: 10,000 targets of 1,000 arms
FIRST_OF_PREDICTION = 1_000_000  # number of the first: none of the arms of the trials
PREDICTED = (SET_S, SCENARIOS[-1])  # set S, and the best that calibration achieves with spheres as in a case
TRIALS, SOURCES, PREDICTION, SCENARIO = "trials", "sources", "prediction", "scenarios"
BIN_MM = 0.005  # of the histograms
OF_ARM = "arm "  # precedes the number in the key of a sum over one arm
SCANNED_AGAIN, NO_CT, ANY_SIDE = "CT scanned again in every place", "no CT error", "servo ends on any side"
TILTED_ALIKE = "trajectories tilted alike"
READINGS = (SCANNED_AGAIN, NO_CT, ANY_SIDE, TILTED_ALIKE)
READ_AGAIN = ("nos", "thesis-ocs")  # strategies run under the other interpretations


@dataclass(frozen=True)
class StrategiesStudy(Study):
    """Study of `arms` random arms at all positions, with our strategies, the thesis' and the user's."""

    arms: int = 200
    seed: int = 0
    name: str = "strategies"
    own: tuple[PluginMethod, ...] = ()

    constants: ClassVar = {"places": PLACES, "targets": TARGETS, "depths_mm": list(DEPTHS_MM)}

    def units(self) -> Sequence[Unit]:
        places, few = range(1, PLACES + 1), min(self.arms, MOST_ARMS_OF_SOURCES)
        many = min(self.arms, MOST_ARMS_OF_OTHERS)
        parts = [(product((TRIALS,), Markers, places), self.arms)]
        if not self.own:
            parts += [
                (product((SOURCES,), Markers, places), few),
                (product((PREDICTION,), Markers, places), ARMS_OF_PREDICTION),
                (product((SCENARIO, *READINGS), (Markers.FREE,), places), many),
            ]
        return [unit for keys, arms in parts for unit in blocks_of_each(keys, arms, BLOCK_ARMS)]

    def run(self, unit: Unit) -> Sums:
        """Run one part of the study. Returns single errors in mm, or sums, with keys specific to the part."""
        part, kind, number = unit.condition.split("|")
        markers, tilts = Markers(kind), ALIKE if part == TILTED_ALIKE else USUAL_TILTS
        drawn = draw_phantom(markers, DEPTHS_MM, TARGETS, tilts=tilts)
        own = tuple(PluginStrategy.of(one) for one in self.own)
        scene = StudiedScene.of(self.seed, drawn, markers, int(number), own)
        first = unit.block * BLOCK_ARMS + (FIRST_OF_PREDICTION * int(number) if part == PREDICTION else 0)
        arms = range(first, first + unit.runs)
        if part == TRIALS:
            known = BESIDE_OWN if own else STRATEGIES
            return scene.trials(arms, (*known, *(one.name for one in own)))
        if part == SOURCES:
            return _run_sources(scene, arms)
        if part == SCENARIO:
            return _run_scenarios(scene, arms)
        return _run_predictions(scene, arms) if part == PREDICTION else _run_reading(scene, arms, part)


def _run_sources(scene: StudiedScene, arms: Sequence[int]) -> Sums:
    """Return error sums for each source alone, `strategy|spheres|source`, and counts, `strategy|spheres`."""
    drawn, chance = RandomArms.draw(scene.seed, arms), scene.chance(arms)
    found: Sums = {}
    for strategy in ALONE:
        planned = scene.planned(strategy)
        for source in Source:
            errors = scene.errors_mm(drawn.only(source), planned, chance, Sizes().only(source))
            for count, sum_mm in zip(
                scene.counts, np.linalg.norm(errors, axis=-1).sum(axis=(0, 1)), strict=True
            ):
                found[f"{strategy}|{count}|{source}"] = round(float(sum_mm), DIGITS)
        found |= {f"{strategy}|{count}|": float(len(arms) * TARGETS) for count in scene.counts}
    return found


def _run_predictions(scene: StudiedScene, arms: Sequence[int]) -> Sums:
    """Return sums of predicted and actual errors, keyed `scenario|strategy|spheres|quantity`."""
    drawn, chance = RandomArms.draw(scene.seed, arms), scene.chance(arms)
    sums: dict[str, float] = defaultdict(float)
    for scenario in PREDICTED:
        for strategy, outcome in scene.outcomes(STRATEGIES, drawn, chance, scenario).items():
            for (nth, count), target in product(enumerate(scene.counts), range(TARGETS)):
                prediction, actual = outcome.predictions[nth][target], outcome.errors_mm[:, target, nth]
                key = f"{scenario.name}|{strategy}|{count}"
                sums[f"{key}|targets"] += len(arms)
                sums[f"{key}|inside"] += int(prediction.mark_contained(actual).sum())
                sums[f"{key}|actual2"] += float(np.square(actual).sum())
                sums[f"{key}|predicted2"] += len(arms) * prediction.rms_mm**2
    return dict(sums)


def _run_scenarios(scene: StudiedScene, arms: Sequence[int]) -> Sums:
    """Return error histograms and sums by arm: `scenario|strategy|spheres|` then bin, or `arm` number."""
    drawn, chance = RandomArms.draw(scene.seed, arms), scene.chance(arms)
    found: dict[str, float] = defaultdict(float)
    for one in SCENARIOS:
        for strategy, outcome in scene.outcomes(STRATEGIES, drawn, chance, one).items():
            lengths = np.linalg.norm(outcome.errors_mm, axis=-1).round(DIGITS)
            for place_of_count, count in enumerate(scene.counts):
                of_count = lengths[:, :, place_of_count]
                key = f"{one.name}|{strategy}|{count}"
                for arm, sum_mm in zip(arms, of_count.sum(axis=1).tolist(), strict=True):
                    found[f"{key}|{OF_ARM}{arm}"] = round(sum_mm, DIGITS)
                for number in (of_count.ravel() / BIN_MM).astype(int).tolist():
                    found[f"{key}|{number}"] += 1.0
    return dict(found)


def _run_reading(scene: StudiedScene, arms: Sequence[int], reading: str) -> Sums:
    """Run the trials under another interpretation of the protocol, keyed as by `StudiedScene.trials`."""
    return scene.trials(
        arms,
        READ_AGAIN,
        scenario=Scenario(NO_CT, ct_mm=0.0) if reading == NO_CT else SET_S,
        scan_again=reading == SCANNED_AGAIN,
        any_side=reading == ANY_SIDE,
    )
