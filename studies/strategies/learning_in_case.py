"""Worth of `learning` with what a whole case has and the study of `learning` lacks: by the covariance alone.

Each step adds one difference to those before it:

- head, spheres and targets of simulated cases: spheres nearer together, targets further from them and more
  alike;
- the calibrated arm of a simulated case, whose record has its harmonics, sag and backlash without error;
- a scan that may be stretched, by the usual errors of a scanner: none is, but the adjustment allows for it;
- guide and instrument, which no look shows.

In the last step the scan is stretched as allowed for. The arm's sizes are those stated, whatever looks show.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from procedures.imaging.markers import ScanDeformation
from procedures.planning.target_error import scan_errors
from procedures.registration.arm_adjustment import best_influence
from procedures.registration.arm_hypotheses import Source
from procedures.registration.error_sources import INSTRUMENT
from procedures.registration.target_prediction import (
    IndependentErrors,
    SharedErrors,
    influence_of_spheres,
    predict_by_influence,
)
from procedures.strategies.names import DEFAULT_STRATEGY
from procedures.strategies.trajectory import Trajectory
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform
from sim.world.rigid import matrix_of
from sim.world.scene.model import CalibrationError
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.parts import Guide
from studies.accuracy.phantom import FREE_SPHERES, Markers, Phantom, draw_phantom
from studies.accuracy.scene import AXES
from studies.strategies.case_plans import LEARNING, CasePlanner, PlannedLooks
from studies.strategies.learning import SCENARIOS, TARGETS_OF_CASE, plan_case
from studies.strategies.study import DEPTHS_MM

CALIBRATED = "calibrated"
Expected = dict[str, float]
STUDY_PLACES = tuple(range(1, 9))  # of the study's phantom; the judged run has others
CASE_SEEDS = tuple(range(8))  # of simulated cases, for development
STAND_OFF_MM = 30.0  # of the guide from the entry, in the plans of simulated cases
# Of a strain's components as the shapes of five spheres show them, by the usual protocol of simulated cases.
SHOWN = 2.5e-4
UNSTRAINED = ScanDeformation.model_validate(
    {
        "spheres": FREE_SPHERES,
        "strain": np.zeros((AXES, AXES)).tolist(),
        "covariance": np.diag(np.full(5, SHOWN**2)).tolist(),
        "chi_square": 0.0,
        "limit": 1.0,
    }
)
STUDY, HEAD, RECORD, SCAN, GUIDE, STRETCHED = (
    "study",
    "head",
    "record",
    "scan_allowed",
    "guide",
    "scan_stretched",
)


@dataclass(frozen=True)
class Setting:
    """Errors that are stated, and those of them that are there."""

    stated: ErrorSizes
    true: ErrorSizes
    allows_scan: bool = False
    stretches_scan: bool = False
    has_guide: bool = False


def list_settings(kind: str, studied: ErrorSizes) -> dict[str, Setting]:
    """Return the settings on the heads of cases by name, from that of the study to that of a case."""
    head = record = Setting(studied, studied)
    if kind == CALIBRATED:  # the record of a simulated theatre states one share for everything
        stated = replace(studied, joints=studied.links, backlash=studied.links)
        record = Setting(stated, replace(stated, joints=0.0, backlash=0.0))
    scan = replace(record, allows_scan=True)
    guide = replace(scan, has_guide=True)
    return {
        HEAD: head,
        RECORD: record,
        SCAN: scan,
        GUIDE: guide,
        STRETCHED: replace(guide, stretches_scan=True),
    }


def list_planners(kind: str) -> tuple[list[CasePlanner], list[CasePlanner]]:
    """Return planners on the phantom of the study and on the heads of simulated cases."""
    phantom = draw_phantom(Markers.FREE, DEPTHS_MM, TARGETS_OF_CASE)
    studied = [plan_case(kind, phantom, place) for place in STUDY_PLACES]
    heads = [draw_scene("default", seed=seed).head for seed in CASE_SEEDS]
    return studied, [
        replace(
            studied[0],
            phantom=Phantom(
                np.array([one.centre_ct_mm for one in head.fiducials]),
                tuple(Trajectory(one.identifier, one.entry_ct_mm, one.target_ct_mm) for one in head.targets),
            ),
            robot_from_ct=Transform.from_matrix(Frame.ROBOT, Frame.CT, matrix_of(head.robot_from_ct)),
        )
        for head in heads
    ]


def plan_looks(planner: CasePlanner) -> dict[str, PlannedLooks]:
    """Return the looks of both strategies."""
    return {
        DEFAULT_STRATEGY: planner.separate(DEFAULT_STRATEGY),
        LEARNING: planner.choose(planner.candidates(), FREE_SPHERES),
    }


def square_errors_mm2(
    planner: CasePlanner, looks: PlannedLooks, setting: Setting, *, learns: bool
) -> list[float]:
    """Return the expected square error at each target of a case."""
    stated, true = (replace(planner, sizes=one) for one in (setting.stated, setting.true))
    found = []
    for target, used in enumerate(looks.used):
        points_mm, (told,) = stated.sources(looks, used, [target])
        _, (real,) = true.sources(looks, used, [target])
        scan = _scan(planner, looks.spheres[used].tolist(), target)
        if learns:
            allowed = [*told.arm, *told.others, *([scan] if setting.allows_scan else [])]
            influence = best_influence(points_mm, told.target_mm, allowed)
        else:
            influence = influence_of_spheres(points_mm, told.target_mm)
        sources = [
            *real.arm,
            *real.others,
            *([scan] if setting.stretches_scan else []),
            *([_guide(planner, target, len(used))] if setting.has_guide else []),
        ]
        found.append(float(np.trace(predict_by_influence(influence, sources).covariance_mm2)))
    return found


def _scan(planner: CasePlanner, spheres: Sequence[int], target: int) -> SharedErrors:
    """Return the errors of a scan as a whole, as a case states them after spheres without a strain."""
    phantom, rotation = planner.phantom, planner.robot_from_ct.rotation_matrix
    of_spheres = scan_errors(UNSTRAINED, phantom.spheres_mm, phantom.trajectories[target].target_mm, rotation)
    return replace(of_spheres, at_spheres_mm=of_spheres.at_spheres_mm[list(spheres)])


def _guide(planner: CasePlanner, target: int, looks: int) -> Source:
    """Return the errors of guide tip, seat and instrument, alike on all axes."""
    guide, depth_mm = Guide(), planner.phantom.trajectories[target].depth_mm
    share = (STAND_OFF_MM + depth_mm) / guide.bore_mm
    play_mm2 = 2.0 * (guide.play_mm / 4.0) ** 2 * ((1.0 + share) ** 2 + share**2)
    fixed_mm2 = AXES * (CalibrationError().tip_mm ** 2 + guide.seat_mm**2)
    nothing = np.zeros((looks, AXES, AXES))
    total_mm2 = play_mm2 + guide.depth_stop_mm**2 + fixed_mm2
    return IndependentErrors(INSTRUMENT, nothing, np.eye(AXES) * total_mm2 / AXES)


def expect_errors(planners: Sequence[CasePlanner], settings: Mapping[str, Setting]) -> dict[str, Expected]:
    """Return the expected rms by setting and strategy over all targets, and how many cases it is of.

    A case out of reach of any strategy is passed over.
    """
    squares: dict[str, dict[str, list[float]]] = {name: defaultdict(list) for name in settings}
    for planner in planners:
        try:
            planned = {
                one: plan_looks(replace(planner, sizes=one))
                for one in {setting.stated for setting in settings.values()}
            }
        except RonnaError:
            continue
        for name, setting in settings.items():
            for strategy, looks in planned[setting.stated].items():
                squares[name][strategy] += square_errors_mm2(
                    planner, looks, setting, learns=strategy == LEARNING
                )
    return {
        name: {strategy: float(np.sqrt(np.mean(some))) for strategy, some in by_strategy.items()}
        | {"cases": len(by_strategy[LEARNING]) // TARGETS_OF_CASE}
        for name, by_strategy in squares.items()
    }


def main() -> None:
    """Print the expected rms in JSON, by kind of arm, setting and strategy."""
    found: dict[str, dict[str, Expected]] = {}
    for kind in SCENARIOS:
        studied, in_cases = list_planners(kind)
        sizes = studied[0].sizes
        found[kind] = expect_errors(studied, {STUDY: Setting(sizes, sizes)})
        found[kind] |= expect_errors(in_cases, list_settings(kind, sizes))
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
