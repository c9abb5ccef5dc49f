"""Every file of real runs: bytes changed throughout, the file missing, emptied, or replaced by another."""

from __future__ import annotations

import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from spoilt_runs import files_in, with_another_byte

from ronna_hw.evidence.inspection import inspect_run

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600)]

BYTES_OF_A_SLICE = {"mini": 3, "default": 1}  # of a hundred slices and more; each look hashes the whole run
BYTES_OF_A_FILE = {"mini": 60, "default": 8}


@pytest.fixture(scope="module", params=BYTES_OF_A_FILE)
def real_run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    out = tmp_path_factory.mktemp("runs")
    case = ["run", "--sim", "--scene", request.param, "--seed", "3", "--out", str(out)]
    program = Path(sys.executable).with_name("ronna-procedure")
    subprocess.run([program, *case], check=True, capture_output=True)
    (folder,) = out.iterdir()
    assert inspect_run(folder).problems == ()
    return request.param, folder


def named(folder: Path) -> set[str]:
    return {problem.file for problem in inspect_run(folder).problems}


@pytest.mark.hazard(39)
def test_every_changed_byte_is_detected(
    real_run: tuple[str, Path], record_property: Callable[[str, object], None]
) -> None:
    scene, folder = real_run
    draw, changed = random.Random(1), 0
    for path in files_in(folder):
        size = path.stat().st_size
        count = (BYTES_OF_A_SLICE if path.parent.name == "ct" else BYTES_OF_A_FILE)[scene]
        places = {0, size - 1, *(draw.randrange(size) for _ in range(count))}
        for place in places if count > 1 else [draw.randrange(size)]:
            with with_another_byte(path, place, draw.randint(1, 255)):
                assert path.relative_to(folder).as_posix() in named(folder), (path, place)
            changed += 1
    record_property("changed_bytes", changed)
    print(f"{scene}: {changed} changed bytes in {len(files_in(folder))} files, all found")
    assert inspect_run(folder).problems == ()


@pytest.mark.hazard(39)
def test_every_missing_emptied_or_replaced_file_is_named(real_run: tuple[str, Path], tmp_path: Path) -> None:
    _, folder = real_run
    files = files_in(folder)
    for path, other in zip(files, [*files[1:], files[0]], strict=True):
        name = path.relative_to(folder).as_posix()
        aside = path.rename(tmp_path / "aside")
        assert name in named(folder)
        for content in (b"", other.read_bytes() if other.exists() else b"{}"):
            path.write_bytes(content)
            assert name in named(folder)
        aside.rename(path)
    print(f"{len(files)} files gone, emptied and exchanged, all named")
    assert inspect_run(folder).problems == ()
