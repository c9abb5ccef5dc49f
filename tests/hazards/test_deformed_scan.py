"""Hazard 8: the CT is stretched along the normal of the spheres' plane, where no residual would show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from clinical_case import ClinicalCell

from procedures.imaging.errors import ScanDeformed
from procedures.imaging.localization import localize
from procedures.imaging.series import read_series
from procedures.registration import register
from procedures.steps.clinical import fiducial_localization
from procedures.steps.clinical.ct_import import ImportedCt
from sim.phantom.case import write_case
from sim.phantom.scan import plain_scan
from sim.phantom.scanner.faults import ScannerFaults
from sim.world.scene.named_scenes import draw_scene

STRETCH = 0.015
NOTICED_MM = 0.1  # of the residual: the noise of the re-localization is as large


@pytest.mark.hazard(8)
@pytest.mark.hazard(28)
def test_a_stretch_that_only_the_target_would_suffer_from_ends_the_case_at_the_ct(cell: ClinicalCell) -> None:
    scene = draw_scene("mini", seed=0)
    spheres_mm = np.array([one.centre_ct_mm for one in scene.head.fiducials])
    target_mm = np.array(scene.head.targets[0].target_ct_mm)
    _, _, axes = np.linalg.svd(spheres_mm - spheres_mm.mean(axis=0))
    normal = axes[2]
    faults = ScannerFaults(stretch=STRETCH, stretch_along=tuple(normal.tolist()))
    scan = replace(plain_scan(scene), faults=faults)
    written = write_case(scene, cell.folder / "patient", scan=scan)
    volume = read_series(written.series)

    grid = scan.grid
    middle_mm = np.array([grid.x_mm.mean(), grid.y_mm.mean(), grid.z_mm.mean()])
    shown_mm = target_mm + STRETCH * normal * ((target_mm - middle_mm) @ normal)
    found_mm = localize(volume, expected=3).centres_mm
    nearest = [int(np.linalg.norm(found_mm - one, axis=1).argmin()) for one in spheres_mm]
    fit = register(found_mm[nearest], spheres_mm)
    assert fit.fre_mm < NOTICED_MM
    assert np.linalg.norm(fit.transform.apply(shown_mm) - target_mm) > 0.5

    cell.series = written.series
    with pytest.raises(ScanDeformed, match=r"CT-024: by the shape of 3 spheres") as refused:
        cell.run(ImportedCt.from_volume(volume), fiducial_localization.STEP)
    told = refused.value.what.rpartition("by ")[2]
    assert float(told.removesuffix(" %")) == pytest.approx(100.0 * STRETCH, abs=0.25)
