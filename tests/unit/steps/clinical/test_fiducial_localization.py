"""Each sphere of the CT, with the uncertainty of its centre."""

from functools import cache

import numpy as np
import pytest
from clinical_case import ClinicalCell
from numpy.typing import NDArray
from painted_ct import Scan, write_series
from prepared_results import localized_fiducials

from procedures.engine.events import StepState
from procedures.engine.methods import CaseMethods
from procedures.imaging.localizers import Localizer
from procedures.imaging.series import read_series
from procedures.imaging.thesis_localizer import COVARIANCE_ASSUMED
from procedures.journal.errors import GateFailed
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import STEP, LocalizedFiducials


@cache
def voxels_of_one_sphere() -> NDArray[np.int16]:
    scan = Scan()
    scan.marker(np.array([20.0, 20.0, 20.0]), np.array([0.0, 1.0, 0.3]), skin=False)
    return scan.voxels()


@pytest.fixture
def imported(cell: ClinicalCell) -> ImportedCt:
    """A series with one sphere in the case's folder, imported; its voxels are not at hand any more."""
    write_series(cell.series, voxels_of_one_sphere(), origin_mm=(-20.0, -30.0, 40.0))
    return ImportedCt.from_volume(read_series(cell.series))


@pytest.mark.hazard(1)
def test_a_series_that_has_changed_since_its_import_is_refused(
    cell: ClinicalCell, imported: ImportedCt
) -> None:
    moved = imported.model_copy(update={"origin_mm": (-12.0, -30.0, 40.0)})
    with pytest.raises(GateFailed, match="the CT series has changed since it was imported: origin_mm"):
        cell.run(moved, STEP)


def test_a_sphere_is_stored_with_its_covariance_parent_and_picture(
    cell: ClinicalCell, imported: ImportedCt
) -> None:
    stored = cell.run(imported, STEP)
    (found,) = stored.result.markers
    assert found.centre_mm == pytest.approx((0.0, -10.0, 60.0), abs=0.05)
    assert np.linalg.eigvalsh(found.covariance_mm2).min() > 0.0
    assert 0.0 < found.quality <= 1.0
    assert stored.result.disagreement_mm == {0: found.agreement_mm}
    assert list(stored.record.parents) == ["01-ct_import"]
    assert (cell.folder / "pictures" / "ct-1.png").read_bytes().startswith(b"\x89PNG")
    assert found.odds > 0.9
    assert stored.result.doubtful == ()


def test_a_doubtful_sphere_is_stored_with_its_reason_and_odds(cell: ClinicalCell) -> None:
    scan, hollow = Scan(shape=(40, 80, 120)), np.array([20.0, 20.0, 45.0])
    scan.marker(np.array([20.0, 20.0, 20.0]), np.array([0.0, 1.0, 0.3]), skin=False)
    scan.ball(hollow)
    scan.ball(hollow, 2.8, -1000.0)
    write_series(cell.series, scan.voxels(), origin_mm=(-20.0, -30.0, 40.0))
    localized = cell.run(ImportedCt.from_volume(read_series(cell.series)), STEP).result
    assert len(localized.markers) == 1
    (doubtful,) = localized.doubtful
    assert doubtful.centre_mm == pytest.approx((25.0, -10.0, 60.0), abs=0.2)
    assert "of its core is a different material" in doubtful.reason
    assert 0.0 < doubtful.odds < 0.5
    assert (cell.folder / "pictures" / "ct-doubtful-1.png").read_bytes().startswith(b"\x89PNG")


def test_what_the_spheres_together_show_of_the_scan_is_stored(cell: ClinicalCell) -> None:
    scan = Scan(shape=(40, 100, 100), spacing_mm=(1.0, 0.5, 0.5))
    for row_mm, column_mm in ((14.0, 14.0), (14.0, 36.0), (36.0, 14.0), (36.0, 36.0)):
        scan.ball(np.array([20.0, row_mm, column_mm]))
    write_series(cell.series, scan.voxels(), (1.0, 0.5, 0.5))
    localized = cell.run(ImportedCt.from_volume(read_series(cell.series)), STEP).result
    assert localized.deformation is not None
    assert localized.deformation.spheres == 4
    assert np.abs(localized.deformation.strain).max() < 2e-3


def test_a_record_from_before_the_test_of_the_scan_is_readable() -> None:
    older = localized_fiducials().model_dump(mode="json")
    del older["deformation"]
    assert LocalizedFiducials.model_validate(older).deformation is None


@pytest.mark.parametrize(("localizer", "published_mm"), [("thesis-line", 0.1685), ("thesis-sphere", 0.1617)])
def test_a_sphere_of_the_thesis_has_its_published_error_and_says_that_it_is_assumed(
    cell: ClinicalCell, imported: ImportedCt, localizer: str, published_mm: float
) -> None:
    cell.methods = CaseMethods(localizer=Localizer(localizer))
    localized = cell.run(imported, STEP).result
    (found,) = localized.markers
    assert found.centre_mm == pytest.approx((0.0, -10.0, 60.0), abs=0.5)
    assert found.sigma_mm == pytest.approx(published_mm)
    assert COVARIANCE_ASSUMED in found.flags
    assert localized.localizer == localizer
    assert (
        f"{localizer} states no error: its share CT is the {published_mm:.3f} mm" in localized.assumed_error
    )


def test_the_summary_marks_a_localizer_of_the_thesis(cell: ClinicalCell, imported: ImportedCt) -> None:
    cell.methods = CaseMethods(localizer=Localizer.THESIS_SPHERE)
    engine = cell.begin(imported, STEP)
    reader = engine.events.subscribe()
    engine.run_to()
    said = [one.what.summary for one in reader.read(0.0).events if isinstance(one.what, StepState)]
    assert said[-1] == "1 sphere; by thesis-sphere: not for clinical use"
