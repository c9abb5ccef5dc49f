"""Each sphere of the CT, with what its place is worth."""

import numpy as np
import pytest
from clinical_case import ClinicalCell, imported_ct
from painted_ct import Scan, write_series

from procedures.steps.clinical.fiducial_localization import STEP


def test_a_sphere_is_kept_with_its_covariance_its_parent_and_its_picture(cell: ClinicalCell) -> None:
    scan = Scan()
    scan.marker(np.array([20.0, 20.0, 20.0]), np.array([0.0, 1.0, 0.3]), skin=False)
    write_series(cell.case.series, scan.voxels(), origin_mm=(-20.0, -30.0, 40.0))
    stored = cell.run(imported_ct(), STEP)  # the voxels are not at hand: they are read again
    (found,) = stored.result.markers
    assert found.centre_mm == pytest.approx((0.0, -10.0, 60.0), abs=0.05)
    assert np.linalg.eigvalsh(found.covariance_mm2).min() > 0.0
    assert 0.0 < found.quality <= 1.0
    assert stored.result.disagreement_mm == {0: found.agreement_mm}
    assert list(stored.record.parents) == ["01-ct_import"]
    assert (cell.folder / "pictures" / "ct-1.png").read_bytes().startswith(b"\x89PNG")
