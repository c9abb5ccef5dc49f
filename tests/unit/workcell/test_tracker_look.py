"""The frame on the head gives the same spheres whether it is tracked as a tool or as strays."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from procedures.workcell.tracker_look import add_frame_spheres, find_frame_name
from ronna_hw.devices.readings import Stamp, StrayReading, ToolReading, TrackerFrame, Validity
from ronna_hw.x_frame import SPHERE_CENTRES_MM

STAMP = Stamp(1, 1.0, 1.0)
TURN = Rotation.from_rotvec([0.2, -0.4, 0.9])
PLACE_MM = (10.0, -20.0, -1800.0)
OTHER = ((0.0, 0.0, 0.0), (45.0, 60.0, 0.0), (-30.0, 85.0, 0.0), (-62.0, 30.0, 12.0))


@dataclass
class Tracker:
    markers_mm: dict[str, Any] = field(default_factory=lambda: {"M": OTHER, "cross": SPHERE_CENTRES_MM})


def reading(validity: Validity = Validity.OK) -> TrackerFrame:
    w, x, y, z = TURN.as_quat(scalar_first=True).tolist()
    tool = ToolReading("cross", validity, (w, x, y, z), PLACE_MM, 0.1)
    return TrackerFrame(STAMP, Validity.OK, (tool,), (StrayReading((1.0, 2.0, -1500.0), Validity.OK),))


def test_the_frame_is_recognised_by_its_markers_and_not_by_its_name() -> None:
    assert find_frame_name(Tracker().markers_mm) == "cross"
    assert find_frame_name({"M": OTHER}) is None
    assert find_frame_name({"mirrored": [(x, -y, z) for x, y, z in SPHERE_CENTRES_MM]}) is None


def test_the_spheres_of_the_tracked_frame_are_added_to_the_strays() -> None:
    first, *spheres = add_frame_spheres(Tracker(), reading()).strays
    assert first.position_mm == (1.0, 2.0, -1500.0)
    found = np.array([one.position_mm for one in spheres])
    assert found == pytest.approx(TURN.apply(SPHERE_CENTRES_MM) + PLACE_MM)


@pytest.mark.parametrize("validity", [Validity.MISSING, Validity.PARTIAL, Validity.OUT_OF_VOLUME])
def test_no_spheres_are_added_without_a_valid_pose(validity: Validity) -> None:
    seen = reading(validity)
    assert add_frame_spheres(Tracker(), seen) is seen
