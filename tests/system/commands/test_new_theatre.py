"""A lab's own theatre file, from simulated devices on a serial line, a network and a controller's port."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from user_commands import in_this_process

from drivers.kuka_rsi import probe as kuka_probe
from procedures.cli.doctor import inspection
from procedures.cli.procedure import app
from ronna_hw.config import read_theatre_file
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import EXIT_DONE, EXIT_NOT_FOUND
from ronna_hw.host.child_process import ChildProcess, command


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """What a simulated cell says when it is ready."""
    folder = tmp_path_factory.mktemp("cell")
    arguments = ("--scene", "mini", "--first-day", "--out", str(folder))
    with ChildProcess("ronna-sim theatre", command("sim.cli", "theatre", *arguments)) as child:
        yield child.ready


@pytest.fixture(autouse=True)
def _few_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inspection, "PAIRS_LOOKED_AT", 2)
    monkeypatch.setattr(inspection, "FRAMES_LOOKED_AT", 3)


def addresses(cell: dict[str, Any]) -> list[str]:
    """Where this cell is; other tests have theirs beside it, with cameras of the same serial numbers."""
    left, right = (parse_endpoint(cell["endpoints"]["basler"][side]).host for side in ("left", "right"))
    kuka = cell["endpoints"]["kuka"]
    return [
        *("--serial", cell["endpoints"]["polaris"].removeprefix("serial://")),
        *("--interface", "lo", "--left", left, "--right", right),
        *("--controller", kuka["eki_project"].removeprefix("tcp://"), "--stream", kuka["rsi"]),
    ]


def test_devices_are_found_written_to_the_file_and_assessed(cell: dict[str, Any], tmp_path: Path) -> None:
    lab = tmp_path / "lab.toml"
    given = (*addresses(cell), "--clock", cell["endpoints"]["clock"], "--records", cell["file"])
    done = in_this_process(app, "new-theatre", *given, "--out", lab, "--json")
    assert done.returncode == EXIT_DONE, done.stderr
    file, of_cell = read_theatre_file(lab), read_theatre_file(Path(cell["file"]))
    assert file.banner.startswith("REHEARSAL")
    assert file.calibration == of_cell.calibration
    for name, device in file.devices.items():
        assert device.driver == of_cell.devices[name].driver
        assert device.endpoints == of_cell.devices[name].endpoints
        assert device.endpoint == of_cell.devices[name].endpoint
    assert file.robot["master"].options["variant"] == "kr6_r900_sixx"
    assert file.stereo is not None
    assert file.stereo.options["left_serial"] == "21904411"
    assert file.tracker is not None
    assert file.tracker.options["expected_serial"] == "P7-00042"
    verdicts = {one["of"]: one for one in json.loads(done.stdout)["verdicts"]}
    assert all(verdicts[name]["ready"] for name in ("tracker", "robot.master", "stereo"))
    assert "tracker_frame" in " ".join(verdicts["case"]["because"])


def test_a_controller_in_use_is_written_to_the_file_with_the_reason(
    cell: dict[str, Any], tmp_path: Path
) -> None:
    from ronna_hw.control_port import ask_control_port

    lab = tmp_path / "lab.toml"
    ask_control_port(cell["endpoints"]["control"], "fault", line="robot eki taken")
    try:
        done = in_this_process(app, "new-theatre", *addresses(cell), "--no-check", "--out", lab)
    finally:
        ask_control_port(cell["endpoints"]["control"], "clear_faults")
    assert done.returncode == EXIT_DONE
    assert "It could not be identified: EKI-002" in lab.read_text()


def test_no_controller_is_found_where_none_answers(
    cell: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kuka_probe, "CONNECT_LIMIT_S", 0.3)
    lab = tmp_path / "lab.toml"
    refused, not_ours = "tcp://127.0.0.1:9", cell["endpoints"]["kuka"]["eki"]
    said = ""
    for controller in (refused, not_ours):
        given = ("--controller", controller, "--interface", "lo", "--left", addresses(cell)[5])
        given += ("--right", addresses(cell)[7], "--serial", "/dev/null")
        done = in_this_process(app, "new-theatre", *given, "--no-check", "--out", lab)
        assert done.returncode == EXIT_NOT_FOUND
        assert read_theatre_file(lab).robot == {}
        lab.unlink()
        said += done.stderr
    assert f"robot: nothing answers at {refused} (connection refused)" in said
    assert f"robot: {not_ours} does not answer STATUS: it is not the EKI server" in said


def test_a_line_without_a_tracker_leaves_an_example(cell: dict[str, Any], tmp_path: Path) -> None:
    lab = tmp_path / "lab.toml"
    given = ["/dev/null" if text.startswith("/dev/pts") else text for text in addresses(cell)]
    done = in_this_process(app, "new-theatre", *given, "--no-check", "--out", lab)
    assert done.returncode == EXIT_NOT_FOUND
    assert "# tracker: NOT FOUND" in lab.read_text()
    assert read_theatre_file(lab).tracker is None


NAMESPACE = ("unshare", "--user", "--map-root-user", "--net")


@pytest.mark.slow
def test_a_controller_is_found_in_the_named_network_and_no_other_host_is_contacted(tmp_path: Path) -> None:
    if not shutil.which("ip") or subprocess.run((*NAMESPACE, "true"), check=False).returncode != 0:
        pytest.skip("this computer allows no network namespace, or has no `ip`")
    lab = tmp_path / "lab.toml"
    program = Path(__file__).parents[2] / "support" / "arm" / "controller_in_a_network.py"
    done = subprocess.run(
        (*NAMESPACE, sys.executable, "-P", program, lab), capture_output=True, text=True, check=False
    )
    said = json.loads(done.stdout or "{}")
    assert said.get("code") == EXIT_NOT_FOUND, done.stderr  # there is neither tracker nor camera
    assert read_theatre_file(lab).robot["master"].endpoints["eki_project"] == "tcp://10.77.0.4:54602"
    assert not said["knocked"]
