"""Messages, exit codes and tables shared by all commands."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import pytest
import typer
from coded_errors import raises

from ronna_hw.command_line import messages, terminal
from ronna_hw.command_line.errors import (
    DISK_FULL,
    INTERNAL_FAULT,
    NOT_WRITABLE,
    OUT_OF_MEMORY,
    PAGES_MISSING,
    PATH_PROBLEM,
    PORT_IN_USE,
    SYSTEM_REFUSED,
    UsageMistake,
)
from ronna_hw.command_line.options import require_folder
from ronna_hw.errors import LimitError, RonnaError
from ronna_hw.evidence.journal_reading import JOURNAL_FILE
from ronna_hw.host.process import ENDING_SIGNALS
from ronna_hw.logs import PARTS, is_known_logger

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def handlers_restored():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def app_that(body: Callable[[], object]) -> typer.Typer:
    app = typer.Typer()

    @app.command()
    def only(count: int = 1) -> None:
        body()

    return app


def raising(problem: BaseException) -> typer.Typer:
    def body() -> None:
        raise problem

    return app_that(body)


class TooFar(LimitError):
    """An error of the tests."""

    code = "TEST-001"
    action = "Come closer."


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (errno.ENOSPC, DISK_FULL),
        (errno.EROFS, NOT_WRITABLE),
        (errno.EACCES, NOT_WRITABLE),
        (errno.ENOENT, PATH_PROBLEM),
        (errno.EADDRINUSE, PORT_IN_USE),
        (errno.EIO, SYSTEM_REFUSED),
    ],
)
def test_an_operating_system_error_becomes_one_line_with_a_code(
    number: int, kind: type[RonnaError], capsys: pytest.CaptureFixture[str]
) -> None:
    code = terminal.exit_code_of(raising(OSError(number, "text", "/some/folder")), [])
    out, err = capsys.readouterr()
    assert (code, out) == (kind.exit_code, "")
    assert err.startswith(f"{kind.code}: /some/folder: ")
    assert err.count("\n") == 1


def test_a_missing_package_names_the_line_that_installs_it(capsys: pytest.CaptureFixture[str]) -> None:
    missing = ModuleNotFoundError("No module named 'nicegui'", name="nicegui")
    assert terminal.exit_code_of(raising(missing), []) == PAGES_MISSING.exit_code
    err = capsys.readouterr().err
    assert err.startswith(f"{PAGES_MISSING.code}: ")
    assert "pip install 'ronna-hw[console]'" in err


@pytest.mark.parametrize(
    ("problem", "kind"),
    [
        (MemoryError(), OUT_OF_MEMORY),
        (OSError(errno.ENOMEM, "no memory"), OUT_OF_MEMORY),
        (ImportError("cv2.so: failed to map segment from shared object"), OUT_OF_MEMORY),
        (TypeError("x"), INTERNAL_FAULT),
    ],
)
def test_an_unexpected_error_has_a_code_and_no_traceback(
    problem: Exception, kind: type[RonnaError], capsys: pytest.CaptureFixture[str]
) -> None:
    assert terminal.exit_code_of(raising(problem), []) == 1
    err = capsys.readouterr().err
    assert err.startswith(f"{kind.code}: ")
    assert "Traceback" not in err


def test_an_error_of_our_own_keeps_its_exit_code_and_says_what_to_do(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert terminal.exit_code_of(raising(TooFar("reach\nexceeded", limit="0.9 m")), []) == 6
    assert capsys.readouterr().err == "TEST-001: reach exceeded; limit 0.9 m. Come closer.\n"


def test_verbose_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert terminal.exit_code_of(raising(TooFar("reach exceeded")), ["--verbose"]) == 6
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--no-such"], ["--count", "many"], ["surplus"]])
def test_an_invalid_command_line_is_a_usage_mistake(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert terminal.exit_code_of(app_that(lambda: None), arguments) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"{UsageMistake.code}: ")
    assert "--help" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(("typed", "meant"), [("--house", ""), ("--cont", " Did you mean --count?")])
def test_only_an_option_that_resembles_an_unknown_one_is_suggested(
    typed: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert terminal.exit_code_of(app_that(lambda: None), [typed]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"{UsageMistake.code}: unknown option {typed}.{meant} ")
    assert ("Did you mean" in err) == bool(meant)


def test_a_pattern_that_stood_for_several_folders_is_named_as_the_cause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("second").mkdir()
    assert terminal.exit_code_of(app_that(lambda: None), ["second"]) == 2
    assert "'second'. A pattern such as * may stand for several" in capsys.readouterr().err
    Path("second", JOURNAL_FILE).touch()
    assert terminal.exit_code_of(app_that(lambda: None), ["second"]) == 2
    assert "'second'. To go on with this run: ronna-procedure resume second" in capsys.readouterr().err


def test_values_beside_an_option_name_it_and_none_that_every_command_has(
    capsys: pytest.CaptureFixture[str],
) -> None:
    app = typer.Typer()

    @app.command()
    def move(
        _by: Annotated[tuple[float, float, float], typer.Option("--by", metavar="X Y Z")] = (0.0, 0.0, 0.0),
    ) -> None:
        raise AssertionError

    assert terminal.exit_code_of(app, ["3", "0", "0"]) == 2
    said = capsys.readouterr().err
    assert "command line: '3 0 0'. Several values follow their option: --by X Y Z. See" in said
    assert "--log-level" not in said


def test_a_file_without_read_rights_names_whose_it_is_and_who_may_not_read_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    series = tmp_path / "ct"
    series.mkdir()
    monkeypatch.setattr(os, "access", lambda *_given: False)

    app = typer.Typer()

    @app.command()
    def imports(_series: Annotated[Path, typer.Argument(exists=True, readable=True)]) -> None:
        raise AssertionError

    assert terminal.exit_code_of(app, [str(series)]) == 2
    said, owner = capsys.readouterr().err, series.owner()
    assert f"{series}: {owner} may not read it. It is yours: chmod -R u+rX {series}. See" in said


def test_a_command_without_arguments_shows_its_help_unchanged(capsys: pytest.CaptureFixture[str]) -> None:
    app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
    for name in ("make", "show"):
        app.command(name)(lambda: None)
    assert terminal.exit_code_of(app, []) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("Usage: ")
    assert {"  make", "  show"} <= set(line.rstrip() for line in err.splitlines())


@pytest.mark.parametrize(
    ("leaving", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "interrupted\n"),
        (typer.Abort(), 130, "interrupted\n"),
        (typer.Exit(7), 7, ""),
    ],
)
def test_a_command_that_leaves_early_ends_with_its_exit_code(
    leaving: BaseException, code: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert terminal.exit_code_of(raising(leaving), []) == code
    assert capsys.readouterr().err == said


def test_a_table_off_a_terminal_is_tab_separated(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.print_table("title", ["id", "note"], [[1, "[red]text"]])
    assert capsys.readouterr().out == "id\tnote\n1\t[red]text\n"


def test_json_is_one_object_of_finite_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.print_json({"a": [1.5]})
    assert json.loads(capsys.readouterr().out) == {"a": [1.5]}
    with pytest.raises(ValueError, match="JSON"):
        terminal.print_json({"a": float("nan")})


SCRIPT = """
import sys, time, typer
from ronna_hw.command_line import terminal
app = typer.Typer()
@app.command()
def only(wait: bool = False) -> None:
    print("x" * 100_000)
    if wait:
        try:
            print("waiting", flush=True)
            time.sleep(30)
        finally:
            print("closed", file=sys.stderr)
terminal.run(app)
"""


@pytest.fixture
def script(tmp_path: Path) -> list[str]:
    path = tmp_path / "script.py"
    path.write_text(SCRIPT)
    return [sys.executable, str(path)]


def test_a_full_disk_behind_standard_output_is_reported(script: list[str]) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(script, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("CLI-003: no space left on device")
    assert done.stderr.count("\n") == 1


def test_a_closed_output_pipe_prints_no_error_message(script: list[str]) -> None:
    with subprocess.Popen(script, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        child.stdout.close()
        assert child.stderr.read() == b""
    assert child.returncode == 1


@pytest.mark.parametrize("number", ENDING_SIGNALS)
@pytest.mark.usefixtures("hang_ups_count")
def test_a_signal_unwinds_the_command(script: list[str], number: signal.Signals) -> None:
    with subprocess.Popen([*script, "--wait"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        while child.stdout.readline() != b"waiting\n":
            pass
        child.send_signal(number)
        assert child.stderr.read().split() == [b"closed", b"interrupted"]
    assert child.returncode == 130


SPEAKING = (
    "import sys, typer; from ronna_hw.command_line import terminal; from ronna_hw.logs import logger\n"
    "app = typer.Typer()\n"
    "@app.command()\n"
    "def speak() -> None:\n"
    "    for device in ('tracker', 'stereo'):\n"
    "        log = logger(device=device)\n"
    "        log.debug('debug heard'); log.info('info heard'); log.error('error heard')\n"
    "    print('data')\n"
    "terminal.run(app)"
)


LEVELS = {
    "none": [],
    "info": [(level, device) for device in ("tracker", "stereo") for level in ("info", "error")],
    "debug": [(level, device) for device in ("tracker", "stereo") for level in ("debug", "info", "error")],
    "debug of the tracker": [
        (level, "tracker") for level in ("debug", "info", "error")
    ] + [("info", "stereo"), ("error", "stereo")],
    "errors": [("error", "tracker"), ("error", "stereo")],
}  # fmt: skip


def spoken(arguments: str, environment: str, script: str = SPEAKING) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-P", "-c", script, *arguments.split()],
        capture_output=True,
        text=True,
        env={**os.environ, "RONNA_LOG": environment},
    )


@pytest.mark.parametrize(
    ("arguments", "environment", "shown"),
    [
        ("", "", "none"),
        pytest.param("--verbose", "", "info", marks=pytest.mark.slow),
        pytest.param("--verbose", "debug", "debug", marks=pytest.mark.slow),
        ("--verbose", "tracker=debug", "debug of the tracker"),
        ("--verbose --log-level tracker=error", "tracker=debug,stereo=error", "errors"),
    ],
)
def test_verbose_shows_the_log_at_the_levels_set_by_option_and_environment(
    arguments: str, environment: str, shown: str
) -> None:
    done = spoken(arguments, environment)
    assert (done.returncode, done.stdout) == (0, "data\n"), done.stderr
    lines = [line.split() for line in done.stderr.splitlines() if " heard" in line]
    assert [(line[-3], line[-1].removeprefix("device=")) for line in lines] == LEVELS[shown]
    assert arguments or done.stderr == ""


def test_a_process_started_by_exec_inherits_the_log_levels() -> None:
    becoming = (
        "import os, sys, typer; from ronna_hw.command_line import terminal; app = typer.Typer()\n"
        "@app.command()\n"
        "def become() -> None:\n"
        f"    os.execv(sys.executable, [sys.executable, '-P', '-c', {SPEAKING!r}, '--verbose'])\n"
        "terminal.run(app)"
    )
    done = spoken("--log-level tracker=debug", "stereo=error", becoming)
    heard = [line.split() for line in done.stderr.splitlines() if " heard" in line]
    assert [line[-3] for line in heard] == ["debug", "info", "error", "error"], done.stderr


@pytest.mark.parametrize(
    ("arguments", "environment"),
    [("--log-level tracker=loud", ""), ("", "loud"), ("--log-level tacker=debug", ""), ("", "robots=debug")],
)
def test_an_unknown_level_or_logger_is_a_usage_error(
    arguments: str, environment: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RONNA_LOG", environment)
    assert terminal.exit_code_of(app_that(lambda: None), arguments.split()) == 2
    err = capsys.readouterr().err
    assert err.startswith("CLI-001: log level ")
    assert len(err.splitlines()) == 1


def test_every_logger_in_the_sources_can_be_named() -> None:
    parts = set()
    for folder in ("ronna_hw", "conformance", "drivers", "sim", "procedures", "studies", "console"):
        for source in (ROOT / folder).rglob("*.py"):
            parts |= set(re.findall(r'[^`]logger\(part="([^"]+)"', source.read_text()))
    assert parts == set(PARTS)
    assert all(map(is_known_logger, (*parts, "robot.master", "reading.tape", "ronna-sim.polaris")))


@pytest.fixture
def columns(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Set the width of a terminal that is written to."""
    monkeypatch.setattr(messages, "on_terminal", lambda stream: True)
    return lambda width: monkeypatch.setenv("COLUMNS", str(width))


WORDY = [
    ("registration", "register the markers of the series", "procedures.registration"),
    ("a-rather-long-name", "x", "tracker robot stereo " * 4),
]


@pytest.mark.parametrize("width", [72, 80, 90, 100, 140])
def test_a_table_on_a_terminal_cuts_neither_words_nor_headings(
    width: int, capsys: pytest.CaptureFixture[str], columns: Callable[[int], None]
) -> None:
    columns(width)
    headings = ["step", "what it does", "needs-everything"]
    terminal.print_table("title", headings, WORDY)
    printed = capsys.readouterr().out
    shown = printed.split()
    for cell in (*headings, *(cell for row in WORDY for cell in row)):
        for word in cell.split():
            assert word in shown
    assert all(len(line) <= width for line in printed.splitlines())
    assert "\t" not in printed


def test_the_title_of_a_narrow_table_stays_on_one_line(
    capsys: pytest.CaptureFixture[str], columns: Callable[[int], None]
) -> None:
    columns(80)
    title = "Run 20261121T045328-s3-07d9: error of the needle tip against truth"
    terminal.print_table(title, ["target", "error mm"], [["T1", "0.18"]])
    assert capsys.readouterr().out.splitlines()[0] == title


def test_a_heading_too_wide_for_the_terminal_gives_tab_separated_lines(
    capsys: pytest.CaptureFixture[str], columns: Callable[[int], None]
) -> None:
    columns(20)
    terminal.print_table("title", ["a-long-heading", "note"], [[1, "text"]])
    assert capsys.readouterr().out == "a-long-heading\tnote\n1\ttext\n"


ESCAPES = "\x1b[2J\x1b]0;owned\x07 \u202egnp.exe\r\nforged line"


def test_external_names_cannot_inject_escape_sequences_or_lines(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.fail_with(TooFar(f"no series in {ESCAPES}"))
    terminal.tell(f"patient: {ESCAPES}")
    terminal.print_table("title", ["name"], [[ESCAPES]])
    printed = "".join(capsys.readouterr())
    assert all(line.replace("\t", "").isprintable() for line in printed.splitlines())
    assert len(printed.splitlines()) == 5  # a table keeps the line ends of its cells
    assert "\\x1b[2J" in printed
    assert "\\u202e" in printed


def test_long_numbers_and_paths_are_shortened_to_a_line() -> None:
    path = f"/patients/{'a' * 300}/slice.dcm"
    message = str(TooFar(f"cannot read {path}", got="9" * 400))
    assert max(len(word.rstrip(".:")) for word in message.split()) <= 160
    assert "/patients/aaa" in message
    assert "aaa/slice.dcm: 999" in message
    assert len(str(TooFar("word " * 10_000))) < 5000


@pytest.mark.parametrize("umask", [0o000, 0o077])
@pytest.mark.parametrize(
    ("access", "folder", "file"), [(None, 0o700, 0o600), ("owner", 0o700, 0o600), ("group", 0o770, 0o660)]
)
def test_files_written_by_a_command_get_the_configured_access_whatever_the_umask(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, access: str | None, folder: int, file: int, umask: int
) -> None:
    monkeypatch.delenv("RONNA_ACCESS", raising=False)
    if access:
        monkeypatch.setenv("RONNA_ACCESS", access)

    def body() -> None:
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / "journal.jsonl").touch()

    before = os.umask(umask)
    try:
        assert terminal.exit_code_of(app_that(body), []) == 0
        assert os.umask(umask) == umask
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "run").stat().st_mode) == folder
    assert stat.S_IMODE((tmp_path / "run" / "journal.jsonl").stat().st_mode) == file


def test_an_unknown_access_setting_is_a_usage_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RONNA_ACCESS", "everybody")
    assert terminal.exit_code_of(app_that(lambda: None), []) == 2
    assert "CLI-001: RONNA_ACCESS is 'everybody'; expected owner or group" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ("file/sub", "file is a file, so .*sub cannot be made"),
        ("/proc/x", "/proc is on no disk; expected a place on a disk. Name another"),
    ],
)
def test_a_folder_that_cannot_be_made_is_refused_with_what_is_in_its_way(
    tmp_path: Path, inside: str, said: str
) -> None:
    (tmp_path / "file").touch()
    with raises(PATH_PROBLEM, match=f"--out: .*{said}"):
        require_folder(tmp_path / inside)
