from pathlib import Path
from types import ModuleType

import add_a_step
import pytest
from clinical_case import ClinicalCell


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path)


@pytest.fixture(scope="package")
def force_check() -> ModuleType:
    return add_a_step.force_check()
