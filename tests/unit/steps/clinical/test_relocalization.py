"""The spheres are measured where they are, one after the other, with nothing but the coarse registration."""

import math
from itertools import pairwise

import numpy as np
import pytest
from clinical_case import (
    ARRIVING,
    FIRST,
    HOME_RAD,
    ROBOT_FROM_CT,
    SPHERES_MM,
    TRAJECTORIES,
    ClinicalCell,
    OnceForAll,
    checked_paths,
    checked_plan,
    correspondence,
    localized_fiducials,
    shifted,
)

from procedures.engine.case import Stored
from procedures.engine.errors import GateFailed, StepRefused
from procedures.engine.journal import JOURNAL_FILE, read_journal
from procedures.engine.result import StepResult
from procedures.steps.clinical.relocalization import STEP, Relocalization
from procedures.workcell import MountedTool
from procedures.workcell.errors import SphereNotFound
from procedures.workcell.workcell import APPROACH_RAD

COARSE_OFF_MM = (4.0, -3.0, 2.0)


def relocalize(cell: ClinicalCell, **paths: object) -> Stored[Relocalization]:
    return cell.run(*before(cell.carrying(MountedTool.STEREO_HEAD), **paths), STEP)


def before(cell: ClinicalCell, **paths: object) -> tuple[StepResult, ...]:
    return (checked_paths(cell, **paths), correspondence(), checked_plan(), localized_fiducials())


def test_every_sphere_is_measured_where_it_is_in_the_order_of_the_paths(cell: ClinicalCell) -> None:
    done = relocalize(cell, fiducials=(2, 0, 3, 1)).result
    assert done.fiducials == (2, 0, 3, 1)
    np.testing.assert_allclose(done.points_mm, SPHERES_MM[[2, 0, 3, 1]], atol=1e-6)


def test_what_the_first_sphere_teaches_helps_to_find_the_others(cell: ClinicalCell) -> None:
    done = relocalize(cell, robot_from_ct=shifted(ROBOT_FROM_CT, COARSE_OFF_MM)).result
    first, *others = done.residuals_mm
    assert first[0] == pytest.approx(np.linalg.norm(COARSE_OFF_MM))
    assert max(one[0] for one in others) < 1e-3
    assert done.coarse_offset_mm == pytest.approx(np.negative(COARSE_OFF_MM), abs=1e-3)


def test_every_look_is_settled_onto_as_the_joints_arrive_at_the_target(cell: ClinicalCell) -> None:
    relocalize(cell)
    lines = read_journal(cell.folder / JOURNAL_FILE)
    places = [tuple(line["to"]) for line in lines if line.get("what") == "settle"]
    ways = [
        np.subtract(at, back) / APPROACH_RAD
        for (_, back), (_, at) in pairwise(cell.arm.motions)
        if at in places and math.dist(at, back) < 3 * APPROACH_RAD
    ]
    assert len(ways) == len(places) >= len(SPHERES_MM)
    np.testing.assert_allclose(ways, np.tile(ARRIVING, (len(ways), 1)), atol=1e-6)


def test_the_stream_and_the_cameras_run_and_the_surroundings_are_known_before(cell: ClinicalCell) -> None:
    relocalize(cell)
    assert cell.arm.calls == ["surround", "activate"]
    assert cell.stereo.calls == ["activate"]


def test_a_picture_of_every_sphere_is_kept(cell: ClinicalCell) -> None:
    relocalize(cell)
    kept = sorted(path.name for path in (cell.folder / "pictures").iterdir())
    assert kept == [f"stereo-{FIRST}-{number}.png" for number in (1, 2, 3, 4)]


@pytest.mark.hazard(11)
def test_a_sphere_that_is_not_where_the_tracker_saw_it_is_refused_by_its_number_in_the_ct(
    cell: ClinicalCell,
) -> None:
    cell.workcell.spheres_mm[0] += (0.0, 0.0, 6.0)
    with pytest.raises(GateFailed, match=r"PRO-007: sphere 1 is not where the tracker saw it"):
        relocalize(cell, fiducials=(3, 2, 1, 0))


def test_a_sphere_that_is_not_there_ends_the_step(cell: ClinicalCell) -> None:
    cell.workcell.spheres_mm[1] += (0.0, 0.0, 80.0)
    with pytest.raises(SphereNotFound, match="PRO-008"):
        relocalize(cell)


@pytest.mark.hazard(3)
def test_with_the_guide_mounted_nothing_begins(cell: ClinicalCell) -> None:
    steps = before(cell.carrying(MountedTool.STEREO_HEAD))
    cell.carrying(MountedTool.GUIDE)
    with pytest.raises(StepRefused, match="the arm carries the guide, not the stereo head"):
        cell.run(*steps, STEP)
    assert cell.arm.joints_rad == HOME_RAD


def test_a_strategy_that_localizes_once_measures_for_all_trajectories(cell: ClinicalCell) -> None:
    cell.strategy = OnceForAll()
    stored = relocalize(cell)
    assert stored.record.trajectory is None
    assert [str(key) for key in cell.begin(STEP).order.sequence] == ["relocalization"]
    assert len(TRAJECTORIES) == 2
    assert (cell.folder / "pictures" / "stereo-all-1.png").is_file()
