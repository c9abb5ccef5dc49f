"""Each sphere of the CT, with what its place is worth."""

import numpy as np
import pytest
from clinical_case import SERIES, ClinicalCell, imported_ct
from painted_ct import Scan, write_series

from procedures.engine.case import Stored
from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.steps.clinical.fiducial_localization import STEP, LocalizedFiducials

SPHERE_MM = (20.0, 20.0, 20.0)  # slice, row, column


@pytest.fixture
def scan() -> Scan:
    scan = Scan()
    scan.marker(np.array(SPHERE_MM), np.array([0.0, 1.0, 0.3]), skin=False)
    return scan


def localized(cell: ClinicalCell, volume: Volume | None = None) -> Stored[LocalizedFiducials]:
    engine = cell.begin(imported_ct(), STEP)
    if volume is not None:
        engine.setting.workspace.keep(volume)
    engine.run_to()
    return cell.case.get(LocalizedFiducials)


def test_a_sphere_is_kept_with_its_covariance_its_parent_and_its_picture(
    cell: ClinicalCell, scan: Scan
) -> None:
    geometry = VoxelGeometry(scan.shape, np.zeros(3), np.eye(3), np.array(scan.spacing_mm))
    stored = localized(cell, Volume(scan.voxels(), geometry, SERIES, "1.2.3"))
    (found,) = stored.result.markers
    assert found.centre_mm == pytest.approx(SPHERE_MM, abs=0.05)
    assert np.linalg.eigvalsh(found.covariance_mm2).min() > 0.0
    assert 0.0 < found.quality <= 1.0
    assert stored.result.disagreement_mm == {0: found.agreement_mm}
    assert list(stored.record.parents) == ["01-ct_import"]
    assert (cell.folder / "pictures" / "ct-1.png").read_bytes().startswith(b"\x89PNG")


def test_voxels_that_are_not_at_hand_are_read_again(cell: ClinicalCell, scan: Scan) -> None:
    write_series(cell.case.series, scan.voxels(), origin_mm=(-20.0, -30.0, 40.0))
    (found,) = localized(cell).result.markers
    assert found.centre_mm == pytest.approx((0.0, -10.0, 60.0), abs=0.05)
