"""Our packages have common names: a foreign one is refused by its place, a replaced file is named."""

from __future__ import annotations

import base64
import hashlib
import importlib.metadata
import os
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

from ronna_hw.command_line.launch import COMMANDS
from ronna_hw.errors import EXIT_USAGE
from ronna_hw.host.own_packages import (
    OWN_PACKAGES,
    explain_failed_import,
    find_foreign_packages,
    find_replaced_files,
    require_own_packages,
)

ROOT = Path(__file__).resolve().parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SCRIPT = (
    "import sys; sys.argv = ['ronna-sim', '--help']; from ronna_hw.command_line.launch import main; main()"
)
PROGRAM = "from ronna_hw.registry import load_driver; load_driver('kuka_rsi')"


def with_ahead(folder: Path, program: str) -> subprocess.CompletedProcess[str]:
    """The program, with a folder ahead of ours on the path."""
    return subprocess.run(
        [sys.executable, "-P", "-c", program],
        env={**os.environ, "PYTHONPATH": f"{folder}:{ROOT}"},
        capture_output=True,
        text=True,
    )


def test_our_own_packages_are_accepted() -> None:
    require_own_packages()
    assert find_foreign_packages() == {}
    packages = PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]
    assert {name.removesuffix("*") for name in packages} == {*OWN_PACKAGES, "ronna_hw"}


def test_a_command_refuses_foreign_packages_by_their_places_before_it_imports_one(tmp_path: Path) -> None:
    (tmp_path / "sim.py").touch()
    for name in ("console", "procedures"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    done = with_ahead(tmp_path, SCRIPT)
    assert (done.returncode, done.stdout) == (EXIT_USAGE, "")
    assert done.stderr.startswith("CFG-003: ")
    for place in ("sim.py", "console", "procedures"):
        assert str(tmp_path / place) in done.stderr


def test_a_program_beside_a_module_named_drivers_is_told_so(tmp_path: Path) -> None:
    (tmp_path / "drivers.py").touch()
    (tmp_path / "sim.py").touch()  # of which this program needs nothing
    done = with_ahead(tmp_path, PROGRAM)
    assert f"CFG-003: not ours, but first on the path: drivers ({tmp_path}/drivers.py);" in done.stderr


def test_every_installed_command_starts_by_way_of_the_check() -> None:
    assert PROJECT["project"]["scripts"] == dict.fromkeys(COMMANDS, "ronna_hw.command_line.launch:main")
    assert all(find_spec(module) is not None for module in COMMANDS.values())


def test_files_that_another_distribution_replaced_or_removed_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = ""
    for name in ("sim/__init__.py", "sim/cli.py"):
        content = f"# {name}".encode()
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        record += f"{name},sha256={digest},{len(content)}\n"
    info = tmp_path / "ronna_hw-1.dist-info"
    info.mkdir()
    (info / "RECORD").write_text(record)
    installed = importlib.metadata.PathDistribution(info)
    monkeypatch.setattr(importlib.metadata, "distribution", lambda _name: installed)
    assert find_replaced_files() == ()
    assert explain_failed_import("sim.cli", ImportError("no main")) is None
    (tmp_path / "sim" / "__init__.py").write_text("# of another")
    (tmp_path / "sim" / "cli.py").unlink()
    assert find_replaced_files() == ("sim/__init__.py", "sim/cli.py")
    monkeypatch.setattr(importlib.metadata, "packages_distributions", lambda: {"sim": ["ronna-hw", "other"]})
    explained = explain_failed_import("sim.cli", ImportError("no main"))
    assert explained is not None
    assert explained.code == "CFG-003"
    assert "sim/cli.py; other has packages of the same names" in str(explained)


@pytest.mark.parametrize(("link", "status", "said"), [(True, 0, "Usage"), (False, EXIT_USAGE, "CLI-001")])
def test_a_command_called_by_another_name_is_found_through_the_link_or_refused(
    link: bool, status: int, said: str, tmp_path: Path
) -> None:
    (tmp_path / "ronna-sim").touch()
    called = tmp_path / "rsim"
    called.symlink_to("ronna-sim") if link else called.touch()
    code = f"import sys; sys.argv = [{str(called)!r}, '--help']; "
    code += "from ronna_hw.command_line.launch import main; main()"
    done = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=False)
    assert done.returncode == status
    assert said in done.stdout + done.stderr
