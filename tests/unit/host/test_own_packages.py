"""A foreign package under one of our names keeps a program from starting."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from ronna_hw.host.process import OWN_PACKAGES, foreign_packages, require_own_packages

PROGRAM = """
from ronna_hw.host.process import ForeignPackage, require_own_packages
try:
    require_own_packages()
except ForeignPackage as error:
    print(error)
"""


def test_our_own_packages_are_accepted() -> None:
    require_own_packages()
    assert foreign_packages() == ()


def test_foreign_packages_ahead_on_the_path_are_refused_by_name(tmp_path: Path) -> None:
    for name in OWN_PACKAGES:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    done = subprocess.run(
        [sys.executable, "-P", "-c", PROGRAM],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith("CFG-003: ")
    assert " and ".join(OWN_PACKAGES) in done.stdout
