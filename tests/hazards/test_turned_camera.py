"""Hazard 26: a camera that turns in its mount during a case is detected before its positions are used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clinical_case import SPHERES_MM, ClinicalCell
from coded_errors import raises
from prepared_results import checked_paths, checked_plan, coarse
from prepared_results import localized_fiducials as fiducials

from benchmarks.stereo_head.head_looks import ENDPOINTS
from benchmarks.stereo_head.stereo_cell import StereoCell
from procedures.relocalization.errors import HEAD_TURNED
from procedures.relocalization.triangulation import check_head
from procedures.steps.clinical.relocalization import STEP
from procedures.workcell import MountedTool
from procedures.workcell.centring import CentredSphere
from ronna_hw.config import parse_theatre
from ronna_hw.errors import EXIT_REFUSED
from sim.theatre.theatre_file import theatre_content
from sim.world.scene.named_scenes import draw_scene

SEEDS = range(20)
TURNED = (
    *(["left 0.2"], ["left -0.2"], ["right 0.2"], ["right -0.2"]),
    *(["left 0.2", "right -0.2"], ["left -0.2", "right 0.2"]),
)
RADIUS_MM = 5.75
STATED_MM = 0.02  # error of the theatre's stereo head records


@pytest.mark.hazard(26)
def test_positions_from_a_head_with_a_turned_camera_are_refused(cell: ClinicalCell) -> None:
    cell.carrying(MountedTool.STEREO_HEAD)
    cell.workcell.radii_mm = (RADIUS_MM * 1.0024, RADIUS_MM * 1.0042)  # 0.2 degrees
    before = (checked_paths(cell), *coarse(), checked_plan(), fiducials())
    with raises(HEAD_TURNED, match=r"STE-014.*larger in one.*ronna-stereo check") as refused:
        cell.run(*before, STEP)
    assert refused.value.exit_code == EXIT_REFUSED
    assert len(SPHERES_MM) == 4


@pytest.mark.hazard(26)
def test_spheres_of_a_wrong_size_are_refused_also_when_both_outlines_agree() -> None:
    turned = [(RADIUS_MM * 1.0026, RADIUS_MM * 1.0026)] * 3
    with raises(HEAD_TURNED, match=r"STE-014.*size is wrong; limit 0.05%.*got 0.26"):
        check_head(turned, [0.01] * 3, STATED_MM)
    check_head(turned, [0.01] * 3, STATED_MM, sphere_diameter_mm=2.0 * RADIUS_MM * 1.0026)


@pytest.mark.hazard(26)
def test_lines_of_sight_with_a_larger_gap_than_the_record_states_are_refused() -> None:
    alike = [(RADIUS_MM, RADIUS_MM)] * 3
    check_head(alike, [0.03, 0.5, 0.04], STATED_MM)  # one bad sphere is not the head's fault
    with raises(HEAD_TURNED, match="lines of sight"):
        check_head(alike, [0.11, 0.12, 0.01], STATED_MM)


@pytest.mark.slow
@pytest.mark.hazard(26)
@pytest.mark.parametrize("seed", SEEDS)
def test_a_turn_of_a_fifth_of_a_degree_is_detected_on_every_head_and_an_intact_head_passes(
    seed: int, tmp_path: Path
) -> None:
    scene = draw_scene("default", seed=seed)
    record = parse_theatre(theatre_content(scene, ENDPOINTS, "host:", {}, 1.0)).calibration
    assert record is not None
    cell = StereoCell(scene, record.stereo_head, tmp_path)
    start = cell.draw_start(np.random.default_rng(seed), 1.0)

    def check(sphere: CentredSphere) -> None:
        check_head([sphere.radii_mm], [sphere.ray_gap_mm], record.stereo_head.stated_error_mm)

    check(cell.centre(start))
    for turned in TURNED:
        cell.world.set_fault_script("\n".join(f"at 0 s: camera twist {one} deg" for one in turned))
        with raises(HEAD_TURNED):
            check(cell.centre(start))
