from pathlib import Path

import pytest
from clinical_case import (
    ClinicalCell,
    checked_plan,
    checked_set_up,
    correspondence,
    global_localization,
    imported_ct,
    localized_fiducials,
    mounted_guide,
    relocalization,
)

from procedures.engine.journal import Entry
from procedures.steps.clinical import registration


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    """A cell whose journal is opened, without any step."""
    cell = ClinicalCell(tmp_path / "20261120T000000-s3-abcd")
    opening = {"theatre": "mini scene, seed 3", "banner": "SIMULATED THEATRE", "strategy": "ocs", "seed": 3}
    cell.journal.write(Entry.OPENED, 0.0, **opening)
    return cell


@pytest.fixture
def registered(cell: ClinicalCell) -> Path:
    """Folder of a run that went as far as the registration, and was left."""
    engine = cell.begin(
        *(imported_ct(), localized_fiducials(), checked_plan(), checked_set_up(cell)),
        *(global_localization(), correspondence(), relocalization()),
        registration.STEP,
        mounted_guide(),
    )
    while (key := engine.upcoming) is not None and key.name != "positioning":
        engine.run_step(key)
    engine.close("left")
    return cell.folder
