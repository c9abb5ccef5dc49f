"""Check of all paths of a case that scans the skin: looks at it, besides those at spheres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.planning.skin_tour import tour_views
from procedures.planning.skin_views import choose_views, mark_scannable
from procedures.planning.visits import ArmSetting, Reached
from procedures.registration.surface.errors import NO_STATIONS
from procedures.registration.surface.stations import Station, choose_stations
from procedures.registration.surface.surface import Surface
from procedures.steps.clinical.correspondence import SurfaceStart
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.path_check import CheckedPaths, arm_setting_of, check_all_paths
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.room import ROOM_READS
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.surface.carried_head import find_carried
from procedures.steps.clinical.surface.skin_in_ct import skin_of
from procedures.steps.clinical.surroundings import READS
from procedures.steps.conditions import needs_guide_unmounted
from ronna_hw.arrays import Array
from ronna_hw.frames import Transform

CANDIDATES, VIEWS = 36, 20  # looks that are compared, and among which those on a short way are taken
LOOK_S = 2.1  # theatre time at a look, of four lines
SCAN_S = 52.0  # theatre time of all looks and the ways to them
# Of the middle of a look: skin that it sees.
# Safety against a look at the end that shows too little to tell a slip. Source: length of the line (U).
AROUND_MM = 35.0
# Share of the most skin, of that which a scan is planned for, around the look that it repeats at its end.
# Safety against a head that slips in its clamp during the scan. Source: seed 7, slips of 1 and 2 mm.
CLOSING_SHARE = 0.7
# Safety against a look from which more is expected than its lines show (U).
SEEN_MM = 12.0  # of the skin around the middle of a look: half of a line
FEWEST_VIEWS = 8  # with fewer the scan would be refused for its coverage
CARRIED_VIEWS, FEWEST_CARRIED = 6, 3  # of a head that its clamp has carried: enough for its movement
BESIDE_MM = 6.0  # of a point scanned before: skin that a few looks may compare


def run(context: StepContext) -> Outcome[CheckedPaths]:
    """Choose looks at the skin, and joints for them and for every target. Raises PLAN-007, SRF-033."""
    context.result(ImportedCt)
    context.progress(0.0, "choosing looks at the skin")
    setting, skin = arm_setting_of(context), skin_of(context)
    places_mm = skin.points_mm
    scanned, fewest, is_carried = mark_scannable(skin), FEWEST_VIEWS + 1, False  # one is taken twice
    if context.result(SurfaceStart).carried and (carried := find_carried(context)) is not None:
        before_mm = setting.robot_from_ct.inverse().apply(carried.scan.points_mm)
        apart_mm, _ = cKDTree(before_mm).query(places_mm, distance_upper_bound=BESIDE_MM)
        scanned, fewest, is_carried = scanned & np.isfinite(apart_mm), FEWEST_CARRIED, True
    branch = setting.kinematics.branch_of(setting.start_rad)
    found = choose_views(setting, branch, places_mm[scanned], skin.normals[scanned], CANDIDATES)
    targets_mm = [one.target_mm for one in context.result(CheckedPlan).plan.trajectories]
    views = choose_by_error(setting, found, skin, np.array(targets_mm), is_carried)
    if len(views) < fewest:
        raise NO_STATIONS(
            "the arm can look at few places on the skin", limit=f"{fewest} looks", got=str(len(views))
        )
    context.progress(0.2, "checking every path")
    return check_all_paths(context, replace(setting, skin_looks=views))


def choose_by_error(
    setting: ArmSetting, views: Sequence[Reached], skin: Surface, targets_mm: Array, is_carried: bool
) -> tuple[Transform, ...]:
    """Return the views that lower the expected error at the targets (n, 3), CT mm, most, as they are taken.

    The rest of the scan's time is for others, which are spread over the skin, as far as they are on the way.
    The last one repeats an early one: skin that has shown itself before tells whether the head slipped. Of a
    head that its clamp has carried all looks show such skin, and few are taken.
    """
    if not views:
        return ()
    most = CARRIED_VIEWS if is_carried else VIEWS
    ct_from_robot, points_mm = setting.robot_from_ct.inverse(), skin.points_mm
    stations = []
    middles_mm = ct_from_robot.apply([view.visit.pose.translation_mm for view in views])
    for middle_mm in middles_mm:
        near = np.linalg.norm(points_mm - middle_mm, axis=1) < SEEN_MM
        stations.append(Station(points_mm[near], skin.normals[near], LOOK_S))
    best = choose_stations(stations, targets_mm, worth_mm_per_s=0.0).stations
    chosen = [*best, *(number for number in range(len(views)) if number not in best)][:most]
    needed = min(most, len(best))
    closing = () if is_carried else may_close(middles_mm[chosen], points_mm[mark_scannable(skin)])
    tour = tour_views(setting, [views[number] for number in chosen], needed, LOOK_S, SCAN_S, closing)
    return tuple(one.visit.pose for one in tour)


def may_close(middles_mm: Array, skin_mm: Array) -> list[bool]:
    """Say of looks (m, 3) which see enough of the skin (n, 3) of a scan to show a slip; in one frame."""
    counts = (cdist(middles_mm, skin_mm) < AROUND_MM).sum(axis=1)
    return [bool(one) for one in counts >= CLOSING_SHARE * counts.max()]


STEP = StepSpec(
    CheckedPaths,
    "Check every path",
    Phase.PREPARATION,
    run,
    reads=(ImportedCt, *ROOM_READS, CheckedSetUp, *READS),
    preconditions=needs_guide_unmounted,
)
