"""`ronna-sim phantom` as a user runs it, and its case used by the other commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from parent_death import ends_with_its_parent
from shared_by_workers import made_once
from user_commands import in_this_process

from procedures.cli.ct import app as ronna_ct
from procedures.cli.plan import app as ronna_plan
from ronna_hw.host.child_process import command
from sim.cli import app as ronna_sim


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case of the mini scene."""

    def make(root: Path) -> str:
        folder = root / "new" / "case"
        words = ("phantom", "--scene", "mini", "--seed", "5", "--markers", "5", "--out", folder, "--json")
        done = in_this_process(ronna_sim, *words)
        assert (done.returncode, done.stderr) == (0, "")
        said = json.loads(done.stdout)
        assert (said["slices"], said["markers"], said["targets"]) == (134, 5, 1)
        assert Path(said["series"]) == folder / "ct"
        assert len(list((folder / "ct").glob("*.dcm"))) == 134
        return str(folder)

    return Path(made_once(tmp_path_factory, "phantom", make)[1])


def test_every_sphere_is_found_at_its_true_position(case: Path) -> None:
    done = in_this_process(ronna_ct, "localize", case / "ct", "--expected", 5, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    document, truth = json.loads(done.stdout), json.loads((case / "truth.json").read_text())
    assert document["series_instance_uid"] == truth["series_instance_uid"]
    for sphere in truth["fiducials"]:
        errors = [np.subtract(marker["centre_mm"], sphere["centre_mm"]) for marker in document["markers"]]
        nearest = min(range(len(errors)), key=lambda index: float(np.linalg.norm(errors[index])))
        assert np.linalg.norm(errors[nearest]) < 0.025
        covariance = np.array(document["markers"][nearest]["covariance_mm2"])
        assert errors[nearest] @ np.linalg.solve(covariance, errors[nearest]) < 25.0  # chi², 3 degrees


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "exit_code", "said"),
    [
        (("--tilt-deg", 2), 1, "CT-007: the scanner states a gantry tilt of 2 degrees"),
        (("--tilt-deg", 2, "--tilt-hidden"), 3, "mm longer in one direction than in another"),
    ],
)
def test_spheres_sheared_by_a_tilt_are_refused_whatever_the_headers_say(
    tmp_path: Path, options: tuple[object, ...], exit_code: int, said: str
) -> None:
    words = ("phantom", "--scene", "mini", "--seed", "5", "--out", tmp_path / "case", *options)
    assert in_this_process(ronna_sim, *words).returncode == 0
    done = in_this_process(ronna_ct, "localize", tmp_path / "case" / "ct")
    assert (done.returncode, done.stdout) == (exit_code, "")
    assert said in done.stderr


@pytest.mark.slow
def test_the_plan_is_accepted_for_its_series(case: Path) -> None:
    done = in_this_process(ronna_plan, "check", case / "plan.toml", "--ct", case / "ct", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["passed"] is True


@pytest.mark.slow
def test_the_command_ends_with_its_parent_when_asked_to(tmp_path: Path) -> None:
    line = command("sim.cli", "phantom", "--with-parent", "--out", str(tmp_path))
    assert ends_with_its_parent(line, begun=lambda: any((tmp_path / "ct").glob("*.dcm")))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--cone-beam", "--family", "posts"), "does not follow --family"),
        (("--cone-beam", "--protocol", "poor", "--mr"), "does not follow --protocol, --mr"),
        (("--cone-beam", "--stretch", "0.01"), "does not follow --stretch"),
        (("--cone-beam", "--fiducials", "adhesive"), "does not follow --fiducials"),
        (("--cone-beam", "--scene", "bench"), "none is clamped"),
        (
            ("--cone-beam", "--theatre", "t", "--markers", "4"),
            "--theatre does not follow --markers",
        ),
        (("--aim-mm", "3"), "--aim-mm is for a scan during the operation"),
        (("--theatre", "t"), "--theatre is for a scan during the operation"),
    ],
)
def test_options_that_a_scan_would_not_follow_are_refused(
    tmp_path: Path, options: tuple[str, ...], said: str
) -> None:
    done = in_this_process(ronna_sim, "phantom", "--out", tmp_path / "case", *options)
    assert (done.returncode, done.stdout) == (2, "")
    assert "CLI-001" in done.stderr
    assert said in " ".join(done.stderr.split())
    assert not (tmp_path / "case").exists()


@pytest.mark.slow
def test_the_spheres_of_a_head_with_a_face_are_found_and_nothing_of_the_face(tmp_path: Path) -> None:
    folder = tmp_path / "case"
    words = ("phantom", "--scene", "mini", "--seed", 4, "--fiducials", "mixed", "--family", "intubated")
    done = in_this_process(ronna_sim, *words, "--out", folder, "--json")
    assert json.loads(done.stdout)["markers"] == 2
    truth = json.loads((folder / "truth.json").read_text())
    found = in_this_process(ronna_ct, "localize", folder / "ct", "--json")
    centres = np.array([one["centre_mm"] for one in json.loads(found.stdout)["markers"]])
    spheres = np.array([one["centre_mm"] for one in truth["fiducials"]])
    away = np.linalg.norm(centres[:, None] - spheres, axis=2)
    assert len(centres) == 2
    assert away.min(axis=0).max() < 0.05
