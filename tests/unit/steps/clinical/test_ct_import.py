"""The CT series of the case, recorded without the patient's identity."""

from pathlib import Path

import numpy as np
import pytest
from clinical_case import ClinicalCell
from coded_errors import raises
from painted_ct import write_series

from procedures.imaging.errors import KERNEL_UNNAMED
from procedures.steps.clinical.ct_import import STEP
from ronna_hw.evidence.manifest import ROOM_FILE
from ronna_hw.log_output import LOG_FILE, keep_log

PLAIN = np.arange(5 * 6 * 7, dtype=np.int16).reshape(5, 6, 7) - 1000


def test_the_record_names_the_series_and_its_geometry(cell: ClinicalCell) -> None:
    write_series(cell.series, PLAIN, (1.25, 0.9, 0.4))
    done = cell.run(STEP).result
    assert (done.shape, done.patient_position) == ((5, 6, 7), "HFS")
    assert done.spacing_mm == pytest.approx((1.25, 0.9, 0.4))
    assert done.origin_mm == (-20.0, -30.0, 40.0)
    assert done.axes[0] == (0.0, 0.0, 1.0)


def test_different_voxels_give_a_different_hash(tmp_path: Path) -> None:
    hashes = []
    for number, voxels in enumerate((PLAIN, PLAIN, PLAIN + 1)):
        cell = ClinicalCell(tmp_path / str(number))
        write_series(cell.series, voxels)
        hashes.append(cell.run(STEP).result.voxels_sha256)
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.hazard(35)
def test_the_patients_identity_does_not_enter_the_run_folder(cell: ClinicalCell) -> None:
    write_series(cell.series, PLAIN)
    with keep_log(cell.folder):
        cell.run(STEP)
    written = [path for path in cell.folder.rglob("*") if path.is_file() and path.suffix != ".dcm"]
    assert {path.name for path in written} == {"journal.jsonl", "01-ct_import.json", ROOM_FILE, LOG_FILE}
    assert "step done" in (cell.folder / LOG_FILE).read_text()
    assert not any(b"SECRET" in path.read_bytes().upper() for path in written)


def test_a_series_without_the_name_of_its_kernel_is_refused(cell: ClinicalCell) -> None:
    write_series(cell.series, PLAIN, edit=lambda data, _: data.__delattr__("ConvolutionKernel"))
    with raises(KERNEL_UNNAMED, match=r"CT-027: .* expected ConvolutionKernel \(0018,1210\)"):
        cell.run(STEP)
    assert cell.case.valid_results == ()
