"""The finished run, a copy to spoil, and one that was killed before its end."""

import shutil
from pathlib import Path

import pytest
from finished_runs import finished_run, without_last_lines

from ronna_hw.evidence.manifest import SEAL_FILE


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return finished_run(tmp_path_factory.mktemp("finished") / "run")


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    return shutil.copytree(finished, tmp_path / finished.name)


@pytest.fixture
def killed(run: Path) -> Path:
    """The same run, killed before it was closed."""
    (run / SEAL_FILE).unlink()
    without_last_lines(run, 1)
    return run
