"""The wheel holds all that its commands need: README's work from an empty folder."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path
from zipfile import ZipFile

import pytest
from documented import ROOT, commands_of, python_of

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]  # two of README's commands are whole cases

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = [name.rstrip("*") for name in PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]]
SOURCES = ("pyproject.toml", "README.md", "LICENSE")
NOT_PACKAGED = shutil.ignore_patterns("__pycache__", "*.pyc")
PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy: setuptools leaves its own files beside the sources."""
    folder = tmp_path_factory.mktemp("wheel")
    copy = folder / "sources"
    for package in PACKAGES:
        shutil.copytree(ROOT / package, copy / package, ignore=NOT_PACKAGED)
    for name in SOURCES:
        shutil.copy(ROOT / name, copy)
    build = ("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, copy)
    subprocess.run([*PIP, *build], check=True)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def commands(wheel: Path) -> dict[str, str]:
    """The environment of a shell with the wheel installed, beside the dependencies of this interpreter."""
    home = wheel.parent / "installed"
    venv.create(home, symlinks=True)
    python = home / "bin" / "python"
    subprocess.run([*PIP, "--python", python, "install", "--no-deps", "--no-index", wheel], check=True)
    paths = sysconfig.get_paths(vars={"base": str(home), "platbase": str(home)})
    (Path(paths["purelib"]) / "dependencies.pth").write_text("\n".join(dependency_lines()))
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return environment | {"PATH": f"{home / 'bin'}{os.pathsep}{os.environ['PATH']}"}


def dependency_lines() -> list[str]:
    """Lines of a `.pth` file with the packages installed here, without this checkout."""
    own = Path(sysconfig.get_paths()["purelib"])
    others = [file.read_text() for file in own.glob("*.pth") if not file.name.startswith("__editable__")]
    return [str(own), *(line for text in others for line in text.splitlines())]


def run(line: list[str], folder: Path, environment: dict[str, str]) -> str:
    done = subprocess.run(line, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(line)}: {done.stderr}"
    return done.stdout


def test_every_file_of_the_packages_is_in_the_wheel(wheel: Path) -> None:
    listed = ("git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *PACKAGES)
    tracked = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    assert set(tracked) - set(ZipFile(wheel).namelist()) == set()


@pytest.mark.parametrize("command", PROJECT["project"]["scripts"])
def test_every_command_starts_from_the_wheel(command: str, commands: dict[str, str], tmp_path: Path) -> None:
    assert "Usage" in run([command, "--help"], tmp_path, commands)


def test_readmes_commands_work_from_an_empty_folder(commands: dict[str, str], tmp_path: Path) -> None:
    (shown,) = commands_of("README.md")
    assert "depth mm\tpredicted mm\terror mm" in run(["sh", "-c", shown], tmp_path, commands)
    (report,) = tmp_path.glob("runs/*/report.html")
    assert report.stat().st_size > 0
    told = run(
        ["python", "-c", f"{python_of('README.md')}\nimport ronna_hw\nprint(ronna_hw.__file__)"],
        tmp_path,
        commands,
    )
    assert "T1" in told
    assert str(ROOT) not in told
