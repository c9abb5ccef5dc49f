"""Each bad input gives one clear message with its code and an action, and the documented exit code."""

import json
import resource
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from user_commands import Commands, in_this_process, one_error
from waiting import HANG_LIMIT_S

from procedures.cli.procedure import app as ronna_procedure
from ronna_hw.errors import EXIT_FAILED, EXIT_NOT_FOUND, EXIT_USAGE
from sim.cli import app as ronna_sim
from sim.world.scene.named_scenes import draw_scene


def _refused(done: subprocess.CompletedProcess[str], code: str, exit_code: int) -> str:
    line = " ".join(one_error(done.stderr))
    assert code in line
    assert done.returncode == exit_code, line
    return line


@pytest.fixture
def silent_port() -> Iterator[int]:
    """A TCP port where somebody listens and never answers."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield listener.getsockname()[1]


def _tracker_at(endpoint: str, folder: Path) -> Path:
    path = folder / "theatre.toml"
    path.write_text(
        f'schema = 1\ntheatre = "lab"\n[tracker]\ndriver = "ndi_polaris"\nendpoint = "{endpoint}"\n'
    )
    return path


def _doctor(theatre: Path) -> subprocess.CompletedProcess[str]:
    return in_this_process(ronna_procedure, "doctor", "--config", theatre, "--json")


def test_the_doctor_reports_an_endpoint_that_does_not_answer(silent_port: int, tmp_path: Path) -> None:
    theatre = _tracker_at(f"tcp://127.0.0.1:{silent_port}", tmp_path)
    done = _doctor(theatre)
    assert done.returncode == EXIT_NOT_FOUND
    finding = json.loads(done.stdout)["findings"][-1]
    assert not finding["well"]
    assert "NDI-" in finding["seen"]
    assert finding["advice"]


def test_the_doctor_reports_that_nothing_listens_at_an_endpoint(tmp_path: Path) -> None:
    with socket.socket() as held:  # bound, so that nobody else gets it, and not listening
        held.bind(("127.0.0.1", 0))
        done = _doctor(_tracker_at(f"tcp://127.0.0.1:{held.getsockname()[1]}", tmp_path))
    assert done.returncode == EXIT_NOT_FOUND
    assert "Nothing listens" in json.loads(done.stdout)["findings"][-1]["advice"]


def test_the_doctor_reports_a_device_of_the_wrong_kind(commands: Commands, tmp_path: Path) -> None:
    robot = commands.start(
        "ronna-sim", "kuka", "--eki", "tcp://127.0.0.1:0", "--eki-project", "tcp://127.0.0.1:0"
    )
    assert robot.stdout is not None
    ready = json.loads(robot.stdout.readline().removeprefix("READY "))
    try:
        theatre = _tracker_at(ready["endpoints"]["eki_project"], tmp_path)
        done = _doctor(theatre)
    finally:
        robot.terminate()
        robot.communicate(timeout=HANG_LIMIT_S)
    assert done.returncode == EXIT_NOT_FOUND
    assert "NDI-" in json.loads(done.stdout)["findings"][-1]["seen"]


def test_the_simulator_reports_a_port_in_use(silent_port: int) -> None:
    done = in_this_process(ronna_sim, "polaris", "--endpoint", f"tcp://127.0.0.1:{silent_port}")
    line = _refused(done, "SIM-004", EXIT_NOT_FOUND)
    assert str(silent_port) in line


def test_verify_reports_the_bad_line_of_a_truth_file(tmp_path: Path) -> None:
    theatre = tmp_path / "theatre"
    theatre.mkdir()
    (theatre / "scene.json").write_text(draw_scene("mini").model_dump_json(by_alias=True))
    (theatre / "truth.jsonl").write_text("nonsense\n")
    done = in_this_process(ronna_sim, "verify", tmp_path)
    assert "line 1" in _refused(done, "SIM-007", EXIT_FAILED)


def test_a_read_only_output_folder_is_refused() -> None:
    _refused(_run_mini(Path("/proc/self/runs")), "CLI-00", EXIT_FAILED)


@pytest.mark.parametrize(
    ("option", "content", "said"),
    [
        ("--faults", "at 3 s: robot dorp 2 %\n", "Did you mean: at 3 s: robot drop 2 %?"),
        ("--scene", "schema = 1\nname = 'mine'\n", "head: is missing"),
    ],
)
def test_a_refused_theatre_leaves_no_run_and_gives_the_reason(
    tmp_path: Path, option: str, content: str, said: str
) -> None:
    (path := tmp_path / "given.toml").write_text(content)
    words = ("run", "--sim", option, path, "--out", tmp_path / "new" / "runs")
    assert said in _refused(in_this_process(ronna_procedure, *words), "PRO-013", EXIT_USAGE)
    assert list(tmp_path.iterdir()) == [path]


def _run_mini(out: Path) -> subprocess.CompletedProcess[str]:
    return in_this_process(ronna_procedure, "run", "--sim", "--scene", "mini", "--out", out)


@pytest.mark.slow
@pytest.mark.hazard(33)
def test_a_full_disk_is_reported_and_leaves_no_partial_files(commands: Commands, tmp_path: Path) -> None:
    """A limit on the size of a file stands in for a full disk: the first CT slice already exceeds it."""
    out = tmp_path / "runs"
    done = subprocess.run(
        commands.line("ronna-procedure", "run", "--sim", "--scene", "mini", "--out", str(out)),
        env=commands.environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=150,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000)),
    )
    assert done.returncode == EXIT_FAILED
    assert "ct/slice-0001.dcm: file too large" in " ".join(one_error(done.stderr))
    assert list(out.rglob("*.dcm")) == []
    assert list(out.rglob("*.partial")) == []
