import shutil
from pathlib import Path

import pytest
from clinical_case import ClinicalCell
from prepared_results import checked_paths, mounted_guide, relocalization, up_to_correspondence

from procedures.engine.engine import Engine
from procedures.journal.journal import Entry
from procedures.steps.clinical import registration
from procedures.workcell import MountedTool


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    """A cell whose journal is opened, without any step."""
    return opened_cell(tmp_path)


def opened_cell(folder: Path) -> ClinicalCell:
    cell = ClinicalCell(folder / "20261120T000000-s3-abcd")
    opening = {"theatre": "mini scene, seed 3", "banner": "SIMULATED THEATRE", "strategy": "ocs", "seed": 3}
    cell.journal.write(Entry.OPENED, 0.0, **opening)
    return cell


@pytest.fixture
def engine(cell: ClinicalCell) -> Engine:
    """Of a case that goes as far as the tool change, before its first step."""
    return begin_case(cell)


def begin_case(cell: ClinicalCell) -> Engine:
    cell.carrying(MountedTool.STEREO_HEAD)
    return cell.begin(
        *(*up_to_correspondence(cell), checked_paths(cell), relocalization()),
        registration.STEP,
        mounted_guide(),
    )


@pytest.fixture(scope="session")
def registered_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of that run when all its steps are done, to be copied."""
    engine = begin_case(opened_cell(tmp_path_factory.mktemp("registered")))
    engine.run_to()
    engine.close("left")
    return engine.case.folder


@pytest.fixture
def registered(registered_once: Path, tmp_path: Path) -> Path:
    """A copy of that folder."""
    return Path(shutil.copytree(registered_once, tmp_path / registered_once.name))
