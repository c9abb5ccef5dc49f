from pathlib import Path

import pytest
from clinical_case import ClinicalCell


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path)
