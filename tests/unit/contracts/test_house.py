"""Code rules of the project that can be checked without running it."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import imported
import pytest

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("ronna_hw", "conformance", "drivers", "sim", "procedures", "studies", "console")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
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
        for name in ("procedure", "sim", "ct", "plan", "conformance", "rom", "stereo")
    ),
    "sim.polaris.line.server: scipy cv2 pydicom pinocchio",
    "sim.kuka.controller.cycle_loop: scipy cv2 pydicom",
    "sim.basler.server: scipy cv2 pydicom",
)


def test_drivers_do_not_mention_simulation() -> None:
    for path in (ROOT / "drivers").rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".rom":
            found = re.search(r"(?i)\b(sim\b|simulat)", path.read_text(encoding="utf-8"))
            assert found is None, f"{path.relative_to(ROOT)}: {found}"


# Names that say something only to who wrote them, or have meant several things; in any case, and private.
OPAQUE = {"far_end", "station", "built_in", "stereo_room", "line_holders", "assembly", "reach", "present"}
OPAQUE_WORDS = {"told", "pendant", "reception"}  # also as a part
OPAQUE_CLASSES = {"Stage", "Finding", "Parent", "Answer"}
OF_BROWSERS = re.compile(r"console/|procedures/(cli/console|engine/(engine|orders)|operator/question)\b")


def bound_names(tree: ast.AST) -> Iterator[str]:
    """What a module calls its classes, functions, parameters, variables and attributes."""
    for node in ast.walk(tree):
        match node:
            case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.arg(arg=name):
                yield name.strip("_")
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name.strip("_")


def opaque_names(source: str, *, of_browsers: bool = False) -> set[str]:
    """Those of a module's names that should be others; a `session` is a browser's."""
    opaque = OPAQUE if of_browsers else OPAQUE | {"session", "sessions"}
    names = set(bound_names(ast.parse(source)))
    bodies = re.findall(r"\bcell: CollisionConfig(?! = Field)", source)  # as fields they are in files
    worded = {name for name in names if OPAQUE_WORDS & set(name.lower().split("_"))}
    return {name for name in names if name.lower() in opaque or name in OPAQUE_CLASSES}.union(worded, bodies)


def test_names_that_were_replaced_have_not_come_back() -> None:
    for path in MODULES:
        name = str(path.relative_to(ROOT))
        found = opaque_names(path.read_text(encoding="utf-8"), of_browsers=bool(OF_BROWSERS.match(name)))
        assert not found, f"{name}: {found}"


@pytest.mark.parametrize(
    "source",
    [
        "_pendant = 1",
        "REACH, STEPS = 1.6, 65",
        "_TOLD: dict[str, str] = {}",
        "def told_apart() -> None: ...",
        "class Told: ...",
        "class _Answer: ...",
        "self._reach = 1",
        "def found(present: int) -> None: ...",
        "_session = 1",
        "def around(cell: CollisionConfig) -> None: ...",
    ],
)
def test_a_private_name_and_capitals_are_seen(source: str) -> None:
    assert opaque_names(source)


# Calls on a device; the workcell's own methods have other names, but for `surround`.
MOVES_OR_LOOKS = re.compile(
    r"\.(move_joints|move_linear|drive|grab_pair|set_areas)\(|(?<!workcell)\.surround\("
)


def test_procedures_move_and_measure_only_through_the_workcell() -> None:
    workcell = ROOT / "procedures" / "workcell"
    for path in (ROOT / "procedures").rglob("*.py"):
        if workcell not in path.parents:
            found = MOVES_OR_LOOKS.search(path.read_text(encoding="utf-8"))
            assert found is None, f"{path.relative_to(ROOT)}: {found}"


@pytest.mark.parametrize("folder", ["composition", "engine", "results", "steps", "workcell"])
def test_the_middle_neither_uses_any_as_a_type_nor_silences_the_type_checker(folder: str) -> None:
    for path in (ROOT / "procedures" / folder).rglob("*.py"):
        found = re.search(r"\bAny\b|type: ignore", path.read_text(encoding="utf-8"))
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


# Readers without bounds. What these read is ours, the kernel's, or already within bounds.
READS_WHOLE = {
    "studies/worlds/case.py": "what it has written",
    "studies/worlds/study.py": "what it has written",
    "console/feed/engine_socket.py": "another process of ours",
    "console/web/library.py": "our pages",
    "console/planning/structure_panel.py": "an upload within bounds",
    "drivers/basler_stereo/stream/receiver_orders.py": "another process of ours",
    "drivers/kuka_rsi/realtime/settings.py": "another process of ours",
    "procedures/cli/calibrating/replaced_tables.py": "text within bounds",
    "procedures/cli/doctor/computer.py": "the kernel",
    "procedures/cli/new_theatre/command.py": "what it has written",
    "procedures/engine/events/stream.py": "a line that it has written",
    "procedures/engine/replay/sections.py": "a line that it has written",
    "procedures/imaging/dicom/attributes.py": "a file within bounds",
    "procedures/imaging/dicom/decoder_process.py": "the kernel, and another process of ours",
    "procedures/imaging/dicom/frame_decoder.py": "another process of ours",
    "procedures/reporting/files.py": "a file of known length",
    "procedures/reporting/second_reading.py": "text within bounds, by another parser than the report",
    "studies/campaign/code.py": "our modules",
    "studies/campaign/ledger.py": "what it has written",
    "studies/localization/phantom_scans.py": "another process of ours, and its files",
    "studies/own/beside.py": "modules that are run",
    "ronna_hw/arm/clearance/surroundings.py": "another process of ours",
    "ronna_hw/bounded_input/json_text.py": "text within bounds",
    "ronna_hw/bounded_input/toml_text.py": "text within bounds",
    "ronna_hw/host/child_process.py": "another process of ours",
    "ronna_hw/host/port_users.py": "the kernel",
    "ronna_hw/host/connection_account.py": "the kernel",
    "ronna_hw/software.py": "our packages",
    "ronna_hw/wire/kuka_context.py": "our context",
}
READING_WHOLE = re.compile(
    r"\.read_(?:bytes|text)\(|\bjson\.loads?\(|\btomllib\.loads?\("
    r"|\bfile\.read\(\)|\bdcmread\b|\bnp\.(?:load|fromfile|loadtxt)\(|\bfor line in (?:file|stream)\b"
)


def test_only_these_modules_read_without_bounds() -> None:
    found = {
        path.relative_to(ROOT).as_posix()
        for path in MODULES
        if READING_WHOLE.search(path.read_text(encoding="utf-8"))
    }
    assert found == set(READS_WHOLE)
