"""Map of cart positions compared with the path check, at random positions and orientations.

The path check may refuse no place that the map calls reachable. Of all places it may pass at most 5 % that
the map does not allow. Scene and records are those of a simulated theatre, the head its ellipsoid.

    .venv/bin/python -m benchmarks.place_map
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tomli_w

from benchmarks.stereo_head.head_looks import ENDPOINTS
from procedures.planning.cart_map import map_places, open_judge
from procedures.planning.cart_place import CartCase, CartMove
from procedures.planning.free_angle import choose_free_angles
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.scene import PlanningScene
from procedures.planning.theatre_arm import theatre_arm
from procedures.strategies.catalogue import find_strategy
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.pose import Pose
from sim.theatre.theatre_file import theatre_content
from sim.world.scene.named_scenes import draw_scene

SEED, AWAY_MM, STANDOFF_MM = 3, 130.0, 30.0  # from so far off about two thirds of the map are reachable
TURNS_DEG = (0.0, -15.0, 15.0)
PLACES, WITHIN_MM = 1000, 240.0


@dataclass(frozen=True)
class Agreement:
    """Counts of random places: allowed by the map, of these refused by the check, and missed by the map."""

    turn_deg: float
    places: int
    allowed: int
    refused: int
    lost: int
    map_s: float


def cart_case(scene_name: str, seed: int = SEED, away_mm: float = AWAY_MM) -> CartCase:
    scene = draw_scene(scene_name, seed=seed)
    head = scene.head
    place = Pose.from_quaternion(head.robot_from_ct.translation_mm, head.robot_from_ct.quaternion_wxyz)
    x, y, z, *angles = place.to_kuka()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "theatre.toml"
        file.write_text(tomli_w.dumps(theatre_content(scene, ENDPOINTS, "host:", {}, 1.0)))
        a, b, c = angles
        theatre = theatre_arm(file, (x + away_mm, y, z, a, b, c), None, find_strategy("ocs"))
    fiducials = tuple(one.centre_ct_mm for one in head.fiducials)
    shape = HeadEllipsoid(centre_mm=head.centre_ct_mm, semi_axes_mm=head.semi_axes_mm)
    surroundings = PlanningScene(theatre.surroundings, shape, fiducials).with_reserve(theatre.reserve_mm)
    trajectories = []
    for target in head.targets:
        turn_rad = math.radians(target.free_angle_deg)
        one = Trajectory(target.identifier, target.entry_ct_mm, target.target_ct_mm, turn_rad)
        trajectories.append(one.with_rest(theatre.bore.reach_mm - STANDOFF_MM - one.depth_mm))
    return CartCase(replace(theatre.arm, scene=surroundings), tuple(trajectories), fiducials, theatre.sight)


def agreement(
    case: CartCase, places: int, within_mm: float, turn_deg: float = 0.0, workers: int | None = None
) -> Agreement:
    turn_rad, began_s = math.radians(turn_deg), time.perf_counter()
    with open_judge(case, workers) as judge:
        found = map_places(within_mm, judge, turn_rad=turn_rad)
    map_s = time.perf_counter() - began_s
    tried = np.random.default_rng(11).uniform(-found.within_mm, found.within_mm, (places, 2)).tolist()
    allowed = [found.allows(x, y) for x, y in tried]
    passed = [path_check_passes(case, CartMove(x, y, turn_rad)) for x, y in tried]
    pairs = list(zip(allowed, passed, strict=True))
    return Agreement(
        turn_deg, places, sum(allowed), pairs.count((True, False)), pairs.count((False, True)), map_s
    )


def path_check_passes(case: CartCase, move: CartMove) -> bool:
    """Return whether the path check passes at a place, independently of the map."""
    setting = case.setting_at(move)
    return choose_free_angles(setting, case.trajectories, case.fiducials_mm, case.sight).check.passed


def main(turns_deg: Sequence[float] = TURNS_DEG) -> None:
    """Print one row per cart orientation, splitting the random places evenly among them."""
    print("turned deg\tplaces\tallowed\trefused by the path check\tlost by the map\tmap s")
    case = cart_case("default")
    for index, turn_deg in enumerate(turns_deg):
        count = PLACES * (index + 1) // len(turns_deg) - PLACES * index // len(turns_deg)
        row = agreement(case, count, WITHIN_MM, turn_deg)
        print(
            turn_deg, row.places, row.allowed, row.refused, row.lost, f"{row.map_s:.1f}", sep="\t", flush=True
        )


if __name__ == "__main__":
    main()
