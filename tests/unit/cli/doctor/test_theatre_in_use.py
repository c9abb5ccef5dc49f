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
import typer
from user_commands import in_this_process

from procedures.cli.arm.command import app as ronna_arm
from procedures.cli.doctor import theatre_checks
from procedures.cli.doctor.report import examine
from procedures.cli.doctor.theatre_checks import RUN
from procedures.cli.procedure import app as ronna_procedure
from procedures.cli.stereo.command import app as ronna_stereo
from procedures.journal.journal import Entry, Journal
from procedures.runs import arm_notes
from procedures.runs.arm_notes import TheatreNote, note_paths
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.request_file import RequestFile, write_request
from procedures.runs.theatre_lock import hold_theatre
from ronna_hw.devices.probing import Diagnostic
from ronna_hw.errors import EXIT_REFUSED

RUN_NAME = "20261121T180000-ab12"


def theatre_in(folder: Path) -> Path:
    path = folder / "theatre.toml"
    path.write_text(
        'schema = 1\ntheatre = "lab"\n[tracker]\ndriver = "ndi_polaris"\nendpoint = "tcp://127.0.0.1:1"\n'
    )
    return path


@pytest.fixture(scope="module")
def theatre(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return theatre_in(tmp_path_factory.mktemp("theatre"))


@contextmanager
def run_on(theatre: Path, folder: Path) -> Iterator[int]:
    """A run on this theatre in this folder; yields the number of the process that holds it."""
    hold = "import sys; from procedures.runs.theatre_lock import hold_theatre; from pathlib import Path\n"
    hold += "with hold_theatre(*map(Path, sys.argv[1:])): print('held', flush=True); sys.stdin.read()"
    words = [sys.executable, "-c", hold, str(theatre), str(folder)]
    with Popen(words, stdin=PIPE, stdout=PIPE, text=True) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == "held\n"
        yield run.pid
        run.communicate("")


@pytest.fixture(scope="module")
def using(theatre: Path) -> Iterator[str]:
    """How the run on the theatre is named."""
    with run_on(theatre, theatre.with_name(RUN_NAME)) as number:
        yield f"PRO-043: {RUN_NAME} (pid {number}) is using this theatre"


def test_the_doctor_queries_no_device_in_use_by_a_run_and_names_the_run(tmp_path: Path) -> None:
    theatre, folder = theatre_in(tmp_path), tmp_path / "runs" / RUN_NAME
    with run_on(theatre, folder) as number:
        report = examine(theatre)
    assert report.devices == ()
    (said,) = [one for one in report.case if one.subject == RUN]
    assert f"{folder.name} (pid {number}) is using this theatre" in said.seen
    assert f"ronna-procedure watch {folder}" in said.advice
    assert not report.verdicts[-1].ready
    assert examine(theatre).devices != ()


@pytest.mark.hazard(34)
def test_an_endpoint_of_a_theatre_in_use_is_refused_and_no_device_queried(tmp_path: Path) -> None:
    theatre = theatre_in(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as unit:
        endpoint = f"tcp://127.0.0.1:{unit.getsockname()[1]}"
        theatre.write_text(theatre.read_text().replace("tcp://127.0.0.1:1", endpoint))
        with run_on(theatre, tmp_path / "runs" / RUN_NAME):
            done = in_this_process(ronna_procedure, "doctor", "--config", theatre, "--endpoint", endpoint)
        unit.setblocking(False)
        with pytest.raises(BlockingIOError):
            unit.accept()
    assert done.returncode == EXIT_REFUSED
    assert f"PRO-043: {RUN_NAME}" in done.stderr


@pytest.mark.hazard(34)
def test_a_bare_endpoint_of_a_theatre_in_use_is_refused_before_its_run_has_connected_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arm_notes, "ARMS_FOLDER", tmp_path / "arms")
    theatre, run = theatre_in(tmp_path), tmp_path / "runs" / RUN_NAME
    arm = '[robot.master]\ndriver = "kuka_rsi"\nendpoints = { rsi = "udp://0.0.0.0:1", eki_project = '
    theatre.write_text(theatre.read_text() + arm + '"tcp://192.0.2.1:54602" }\n')
    run.mkdir(parents=True)
    write_request(RunRequest(procedure=CaseProcedure(case=run), config=theatre), run)
    with hold_theatre(theatre, run):
        done = in_this_process(ronna_procedure, "doctor", "--endpoint", "tcp://127.0.0.1:1")
    assert done.returncode == EXIT_REFUSED
    assert f"PRO-043: {RUN_NAME}" in done.stderr
    assert in_this_process(ronna_procedure, "doctor", "--endpoint", "tcp://127.0.0.1:1").returncode != (
        EXIT_REFUSED
    )


@pytest.mark.parametrize(
    "command",
    [
        ("calibrate", "tool-tip", "--out", "other"),
        ("calibrate", "tracker-frame", "--out", "other"),
        ("run", "--case", ".", "--out", "other"),
        ("acknowledge", "--by", "A. Person"),
    ],
)
def test_commands_on_a_theatre_are_refused_while_a_run_uses_it(
    theatre: Path, using: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    done = in_this_process(ronna_procedure, *command, "--config", theatre)
    assert done.returncode == EXIT_REFUSED
    assert using in done.stderr
    assert f"ronna-procedure watch {theatre.with_name(RUN_NAME)}" in done.stderr
    assert not Path("other").exists()


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
    left_run: Path, using: str, command: tuple[str, ...]
) -> None:
    before = read_files(left_run)
    done = in_this_process(ronna_procedure, *command, left_run)
    assert done.returncode == EXIT_REFUSED
    assert using in done.stderr
    assert read_files(left_run) == before


def leave_instrument(theatre: Path, run: Path) -> None:
    """Leave the theatre as a program does that is killed while an instrument is in T1."""
    run.mkdir(parents=True)
    write_request(RunRequest(procedure=CaseProcedure(case=run), config=theatre), run)
    journal = Journal(run)
    journal.write(Entry.OPENED, 0.0, run=run.name)
    journal.write(Entry.MOTION, 1.0, step="positioning:T1", what="approach")
    journal.write(Entry.INSTRUMENT, 2.0, trajectory="T1", inside=True)
    journal.close()
    with hold_theatre(theatre, None):
        note = TheatreNote(run=run, moved_before=run)
    next(iter(note_paths(theatre))).write_text(note.model_dump_json())


@pytest.mark.hazard(5)
@pytest.mark.hazard(44)
@pytest.mark.parametrize("ask", [(), ("--ask",)])
@pytest.mark.parametrize(
    ("app", "command"),
    [
        (ronna_procedure, ("run", "--case", ".")),
        (ronna_procedure, ("step", "--case", ".")),
        (ronna_procedure, ("calibrate", "tool-tip")),
        (ronna_procedure, ("calibrate", "tracker-frame")),
        (ronna_stereo, ("calibrate",)),
        (ronna_stereo, ("check", "--baseline", "baseline")),
        (ronna_stereo, ("measure",)),
        (ronna_stereo, ("measure", "--find")),
        (ronna_arm, ("calibrate",)),
        (ronna_arm, ("check",)),
    ],
)
def test_no_run_begins_while_the_instrument_of_another_may_be_inside(
    tmp_path: Path, app: typer.Typer, command: tuple[str, ...], ask: tuple[str, ...]
) -> None:
    theatre, left = theatre_in(tmp_path), tmp_path / "runs" / RUN_NAME
    leave_instrument(theatre, left)
    done = in_this_process(app, *command, *ask, "--config", theatre, "--out", tmp_path / "other")
    assert done.returncode == EXIT_REFUSED
    assert done.stdout == ""
    assert "PRO-047" in done.stderr
    assert "an instrument is still in T1" in done.stderr
    assert f"ronna-procedure home {left}" in done.stderr
    assert not (tmp_path / "other").exists()


@pytest.mark.hazard(5)
@pytest.mark.hazard(44)
@pytest.mark.parametrize("command", ["resume", "home"])
def test_no_other_run_is_resumed_while_an_instrument_may_be_inside(tmp_path: Path, command: str) -> None:
    theatre, left, other = theatre_in(tmp_path), tmp_path / "runs" / RUN_NAME, tmp_path / "runs" / "other"
    leave_instrument(theatre, left)
    other.mkdir()
    write_request(RunRequest(procedure=CaseProcedure(case=other), config=theatre), other)
    done = in_this_process(ronna_procedure, command, other)
    assert done.returncode == EXIT_REFUSED
    assert "PRO-047" in done.stderr
    own = in_this_process(ronna_procedure, "home", left)
    assert "PRO-047" not in own.stderr


@pytest.mark.hazard(34)
def test_the_doctor_says_first_that_an_unfinished_run_left_an_instrument_and_not_to_mount_another_tool(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    theatre, run = theatre_in(tmp_path), tmp_path / "runs" / RUN_NAME
    leave_instrument(theatre, run)
    monkeypatch.setattr(theatre_checks, "resumable_run", lambda _theatre: run)
    first, *_ = examine(theatre).diagnostics
    assert (first.subject, first.well) == ("instrument", False)
    assert first.seen == f"run {RUN_NAME} on this theatre is unfinished: an instrument is still in T1"
    assert f"ronna-procedure home {run}" in first.advice
    tool = Diagnostic("robot.master: mounted tool", False, "PRO-009", "Mount the named tool.")
    message = Diagnostic("robot.master: messages", False, "number 1 is not acknowledged", "Acknowledge it.")
    tool, message = theatre_checks.advise_on_unfinished_run(theatre, [tool, message])
    assert tool.advice == "Do not touch the tool: an instrument is still in T1."
    assert message.advice == f"Remove its cause; then ronna-procedure acknowledge {run} --by 'YOUR NAME'."


def read_files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
