"""Code rules of the project that can be checked without running it."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import imported
import pytest

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("ronna_hw", "conformance", "drivers", "sim", "procedures", "studies", "console")
# Modules, and commands that show their help, with what they must not import: in this order in one process, as
# what is imported stays.
LIGHT = (
    "ronna_hw: numpy scipy cv2 pydantic structlog",
    "drivers.basler_stereo.stream.receiver_process: numpy scipy cv2 pydicom pydantic structlog",
    "procedures.cli.procedure: numpy scipy cv2 pydantic pydicom matplotlib",
    "ronna-ct localize: numpy scipy cv2 pydicom matplotlib",
    "ronna-plan check: numpy scipy cv2 pydicom matplotlib",
    "ronna-campaign registration: numpy scipy cv2 pydicom matplotlib",
    *(
        f"ronna-{name}: scipy cv2 pydicom matplotlib"
        for name in ("procedure", "sim", "ct", "plan", "conformance", "rom", "stereo", "dicom")
    ),
    "sim.polaris.line.server: scipy cv2 pydicom pinocchio",
    "sim.kuka.cycle_loop: scipy cv2 pydicom",
    "sim.basler.server: scipy cv2 pydicom",
)


def test_drivers_do_not_mention_simulation() -> None:
    for path in (ROOT / "drivers").rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".rom":
            found = re.search(r"(?i)\b(sim\b|simulat)", path.read_text(encoding="utf-8"))
            assert found is None, f"{path.relative_to(ROOT)}: {found}"


# Calls on a device; the methods of the workcell's arms have other names, but for `surround`.
MOVES_OR_LOOKS = re.compile(r"\.(move|grab_pair|set_areas)\(|(?<!master)(?<!assistant)\.surround\(")


def test_procedures_move_and_measure_only_through_the_workcell() -> None:
    workcell = ROOT / "procedures" / "workcell"
    for path in (ROOT / "procedures").rglob("*.py"):
        if workcell not in path.parents:
            found = MOVES_OR_LOOKS.search(path.read_text(encoding="utf-8"))
            assert found is None, f"{path.relative_to(ROOT)}: {found}"


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_has_a_docstring(package: str) -> None:
    for path in (ROOT / package).rglob("__init__.py"):
        assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))), path.relative_to(ROOT)


@pytest.mark.parametrize("name", ["locked.txt", "run.txt"])
def test_a_lock_file_has_hashes_and_no_package_index(name: str) -> None:
    lock = (ROOT / "requirements" / name).read_text(encoding="utf-8")
    assert "://" not in lock
    assert lock.count("--hash=sha256:") > lock.count("==")


def test_the_runtime_lock_is_a_subset_of_the_tested_lock() -> None:
    run, every = (
        set(re.findall(r"^([\w.-]+==\S+)", (ROOT / "requirements" / name).read_text(), re.MULTILINE))
        for name in ("run.txt", "locked.txt")
    )
    assert run
    assert run < every


def test_no_process_imports_packages_that_it_does_not_need_and_every_command_shows_its_help() -> None:
    program = Path(imported.__file__)
    done = subprocess.run([sys.executable, "-P", program, *LIGHT], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")
