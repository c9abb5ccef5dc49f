"""Check of all paths of a case without markers: looks at the skin in the place of looks at spheres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.planning.line_of_sight import SkinSight
from procedures.planning.skin_views import choose_views
from procedures.registration.surface.errors import NO_STATIONS
from procedures.registration.surface.regions import HeadAxes
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.path_check import CheckedPaths, arm_setting_of, check_all_paths
from procedures.steps.clinical.room import ROOM_READS
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.surface.skin_in_ct import skin_of
from procedures.steps.clinical.surroundings import READS
from procedures.steps.conditions import needs_guide_unmounted
from procedures.strategies.skin_looks import SkinLooks

VIEWS = 20  # of three lines each: 60 lines
FEWEST_VIEWS = 8  # with fewer the scan would be refused for its coverage
# Parts that hair grows on, or that lie on the headrest: a line does not show the skin there.
NOT_SCANNED = ("vault", "occiput", "neck")


def run(context: StepContext) -> Outcome[CheckedPaths]:
    """Choose looks at the skin, and joints for them and for every target. Raises PLAN-007, SRF-033."""
    context.result(ImportedCt)
    context.progress(0.0, "choosing looks at the skin")
    setting, skin = arm_setting_of(context), skin_of(context)
    places_mm = skin.points_mm
    scanned = ~np.isin(HeadAxes.of(skin).name_parts(places_mm), NOT_SCANNED)
    branch = setting.kinematics.branch_of(setting.start_rad)
    views = choose_views(setting, branch, places_mm[scanned], skin.normals[scanned], VIEWS)
    if len(views) < FEWEST_VIEWS:
        raise NO_STATIONS(
            "the arm can look at few places on the skin", limit=f"{FEWEST_VIEWS} looks", got=str(len(views))
        )
    context.progress(0.2, "checking every path")
    setting = replace(setting, strategy=SkinLooks(views))
    sight = SkinSight.of(context.workcell.calibrations.stereo_head)
    return check_all_paths(context, setting, sight, np.empty((0, 3)), range(len(views)))


STEP = StepSpec(
    CheckedPaths,
    "Check every path",
    Phase.PREPARATION,
    run,
    reads=(ImportedCt, *ROOM_READS, CheckedSetUp, *READS),
    preconditions=needs_guide_unmounted,
)
