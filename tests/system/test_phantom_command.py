"""`ronna-sim phantom` as a user runs it, and its case in the hands of the other commands."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ronna_hw.host.child_process import command

LARGEST_ERROR_MM = 0.05


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case of the mini scene."""
    folder = tmp_path_factory.mktemp("phantom") / "new" / "case"
    done = run("sim.cli", "phantom", "--scene", "mini", "--seed", "5", "--markers", "5", "--out", folder)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return folder


def ronna(name: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """One of the installed commands."""
    script = str(Path(sys.executable).with_name(name))
    return subprocess.run([script, *map(str, arguments)], capture_output=True, text=True, timeout=150)


def run(module: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(module, *map(str, arguments)), capture_output=True, text=True, timeout=150)


def test_every_sphere_is_found_in_the_scan_and_nothing_else(case: Path) -> None:
    done = ronna("ronna-ct", "localize", case / "ct", "--json")
    assert done.returncode == 0, done.stderr
    found = np.array([marker["centre_mm"] for marker in json.loads(done.stdout)["markers"]])
    truth = json.loads((case / "truth.json").read_text())["fiducials"]
    assert len(found) == len(truth) == 5
    for fiducial in truth:
        assert np.linalg.norm(found - fiducial["centre_mm"], axis=1).min() < LARGEST_ERROR_MM


def test_the_plan_is_accepted_for_its_series(case: Path) -> None:
    done = ronna("ronna-plan", "check", case / "plan.toml", "--ct", case / "ct", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["passed"] is True


def test_json_says_what_was_written(tmp_path: Path) -> None:
    done = run("sim.cli", "phantom", "--scene", "mini", "--out", tmp_path, "--json")
    said = json.loads(done.stdout)
    assert (said["slices"], said["markers"], said["targets"]) == (134, 3, 1)
    assert len(list(Path(said["series"]).glob("*.dcm"))) == 134


@pytest.mark.parametrize(
    ("arguments", "code", "exit_code"),
    [
        (("--scene", "/nowhere/scene.toml", "--out", "{tmp}/new"), "SIM-001", 2),
        (("--markers", "9", "--out", "{tmp}"), "CLI-001", 2),
        ((), "CLI-001", 2),
        (("--scene", "mini", "--out", "{tmp}/file/case"), "CLI", 1),
        (("--scene", "mini", "--out", "{tmp}"), "SIM-011", 2),
    ],
)
def test_mistakes_are_one_message_with_a_code(
    tmp_path: Path, arguments: tuple[str, ...], code: str, exit_code: int
) -> None:
    (tmp_path / "file").write_text("in the way")
    done = run("sim.cli", "phantom", *(argument.format(tmp=tmp_path) for argument in arguments))
    assert done.stderr.startswith(code), done.stderr
    assert len(done.stderr.strip().splitlines()) <= 2
    assert done.returncode == exit_code


def test_it_ends_with_its_parent_when_told_to(tmp_path: Path) -> None:
    parent_program = (
        "import subprocess, sys\n"
        "child = subprocess.Popen(sys.argv[1:])\n"
        "print(child.pid, flush=True)\n"
        "child.wait()\n"
    )
    arguments = command("sim.cli", "phantom", "--with-parent", "--out", str(tmp_path))
    parent = subprocess.Popen(
        [sys.executable, "-c", parent_program, *arguments], stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    child = os.pidfd_open(int(parent.stdout.readline()))
    while not list((tmp_path / "ct").glob("*.dcm")):
        time.sleep(0.02)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert select.select([child], [], [], 2.0)[0], "still there after 2 s"
    os.close(child)
