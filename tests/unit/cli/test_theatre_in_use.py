"""While a run uses the devices of a theatre, other commands leave them alone and name that run."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from subprocess import PIPE, Popen

import pytest
from user_commands import in_this_process

from procedures.cli.case.request_file import RequestFile
from procedures.cli.doctor.report import RUN, examine
from procedures.cli.procedure import app as ronna_procedure
from procedures.journal.journal import Entry, Journal
from ronna_hw.errors import EXIT_REFUSED


@pytest.fixture
def theatre(tmp_path: Path) -> Path:
    path = tmp_path / "theatre.toml"
    path.write_text(
        'schema = 1\ntheatre = "lab"\n[tracker]\ndriver = "ndi_polaris"\nendpoint = "tcp://127.0.0.1:1"\n'
    )
    return path


@contextmanager
def run_on(theatre: Path, folder: Path) -> Iterator[int]:
    """A run on this theatre in this folder; yields the number of the process that holds it."""
    hold = "import sys; from procedures.engine.theatre_lock import held_theatre; from pathlib import Path\n"
    hold += "with held_theatre(*map(Path, sys.argv[1:])): print('held', flush=True); sys.stdin.read()"
    words = [sys.executable, "-c", hold, str(theatre), str(folder)]
    with Popen(words, stdin=PIPE, stdout=PIPE, text=True) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == "held\n"
        yield run.pid
        run.communicate("")


def test_the_doctor_queries_no_device_in_use_by_a_run_and_names_the_run(
    theatre: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "runs" / "20261121T180000-ab12"
    with run_on(theatre, folder) as number:
        report = examine(theatre)
    assert report.devices == ()
    (told,) = [one for one in report.case if one.subject == RUN]
    assert f"{folder.name} (pid {number}) is using this theatre" in told.seen
    assert f"ronna-procedure watch {folder}" in told.advice
    assert not report.verdicts[-1].ready
    assert examine(theatre).devices != ()


@pytest.mark.hazard(34)
def test_an_endpoint_of_a_theatre_in_use_is_refused_and_no_device_queried(
    theatre: Path, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as unit:
        endpoint = f"tcp://127.0.0.1:{unit.getsockname()[1]}"
        theatre.write_text(theatre.read_text().replace("tcp://127.0.0.1:1", endpoint))
        with run_on(theatre, tmp_path / "runs" / "20261121T180000-ab12"):
            done = in_this_process(ronna_procedure, "doctor", "--config", theatre, "--endpoint", endpoint)
        unit.setblocking(False)
        with pytest.raises(BlockingIOError):
            unit.accept()
    assert done.returncode == EXIT_REFUSED
    assert "PRO-043: 20261121T180000-ab12" in done.stderr


@pytest.mark.parametrize(
    "command", [("calibrate", "tool-tip"), ("calibrate", "tracker-frame"), ("run", "--case", ".")]
)
def test_calibrate_and_run_are_refused_while_a_run_uses_the_theatre(
    theatre: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    folder, out = tmp_path / "runs" / "20261121T180000-ab12", tmp_path / "other"
    with run_on(theatre, folder) as number:
        done = in_this_process(ronna_procedure, *command, "--config", theatre, "--out", out)
    assert done.returncode == EXIT_REFUSED
    assert f"PRO-043: {folder.name} (pid {number}) is using this theatre" in done.stderr
    assert f"ronna-procedure watch {folder}" in done.stderr
    assert not out.exists()


@pytest.fixture
def left_run(theatre: Path, tmp_path: Path) -> Path:
    """A run on this theatre that was killed after its first motion."""
    folder = tmp_path / "runs" / "20261121T170000-cd34"
    folder.mkdir(parents=True)
    request = RequestFile(
        program=version("ronna-hw"), scene="mini", speed="max", strategy="ocs", config=theatre.resolve()
    )
    content = request.model_dump_json(by_alias=True).encode()
    (folder / "request.json").write_bytes(content)
    journal = Journal(folder)
    journal.write(Entry.OPENED, 0.0, run=folder.name, request_sha256=sha256(content).hexdigest())
    journal.write(Entry.MOTION, 1.0, step="relocalization:T1")
    journal.close()
    return folder


@pytest.mark.parametrize("command", [("resume",), ("home",), ("acknowledge", "--by", "A. Person")])
def test_resume_home_and_acknowledge_of_another_run_are_refused_while_a_run_uses_the_theatre(
    theatre: Path, left_run: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    before = read_files(left_run)
    with run_on(theatre, tmp_path / "runs" / "20261121T180000-ab12") as number:
        done = in_this_process(ronna_procedure, *command, left_run)
    assert done.returncode == EXIT_REFUSED
    assert f"PRO-043: 20261121T180000-ab12 (pid {number}) is using this theatre" in done.stderr
    assert read_files(left_run) == before


def test_acknowledge_with_a_config_is_refused_while_a_run_uses_the_theatre(
    theatre: Path, tmp_path: Path
) -> None:
    with run_on(theatre, tmp_path / "runs" / "20261121T180000-ab12") as number:
        done = in_this_process(ronna_procedure, "acknowledge", "--config", theatre, "--by", "A. Person")
    assert done.returncode == EXIT_REFUSED
    assert f"PRO-043: 20261121T180000-ab12 (pid {number}) is using this theatre" in done.stderr


def read_files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
