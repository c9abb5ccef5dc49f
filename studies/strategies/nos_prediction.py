"""Error that `nos` is predicted to have on an uncalibrated arm, at many places of the head."""

from __future__ import annotations

import json
import sys

import numpy as np

from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED_MM
from ronna_hw.errors import RonnaError
from studies.accuracy.many_learned import PlainRegistration
from studies.accuracy.phantom import Markers, draw_phantom
from studies.strategies.learning import TARGETS_OF_CASE, plan_case
from studies.strategies.study import DEPTHS_MM

PLACES = tuple(range(1, 17))
MARGIN_MM = 2.0  # the usual one of a plan


def main() -> None:
    """Print mean, smallest and largest rms over all targets in JSON, and how many are beyond the margin."""
    phantom, found = draw_phantom(Markers.FREE, DEPTHS_MM, TARGETS_OF_CASE), []
    for place in PLACES:
        planner = plan_case("uncalibrated", phantom, place)
        try:
            looks = planner.separate("nos")
        except RonnaError:  # a place from which a strategy does not reach a target
            continue
        points, targets = planner.sources(looks, looks.used[0], range(TARGETS_OF_CASE))
        predicted = PlainRegistration.of(points, targets, UNCALIBRATED_MM).covariances_mm2
        found += np.sqrt(np.trace(predicted, axis1=1, axis2=2)).tolist()
    beyond = float(np.mean(np.array(found) > MARGIN_MM))
    summary = {
        "targets": len(found),
        "mean_mm": float(np.mean(found)),
        "smallest_mm": min(found),
        "largest_mm": max(found),
        "beyond_margin_percent": 100.0 * beyond,
    }
    sys.stdout.write(json.dumps(summary, indent=1) + "\n")


if __name__ == "__main__":
    main()
