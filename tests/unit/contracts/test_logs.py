"""Logs: off by default, bounded, with a level per logger, and harmless on a full disk."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ronna_hw import log_output
from ronna_hw.host.child_process import ChildProcess
from ronna_hw.log_output import LOG_FILE, keep_log
from ronna_hw.logs import logger, set_level

NAMES = ("ronna", "ronna.tracker", "ronna.robot", "ronna.robot.master")


@pytest.fixture(autouse=True)
def levels_restored() -> Iterator[None]:
    before = {name: logging.getLogger(name).level for name in NAMES}
    yield
    for name, level in before.items():
        logging.getLogger(name).setLevel(level)


def lines_of(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / LOG_FILE).read_text().splitlines()]


def run_script(script: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True)


def test_a_script_without_log_setup_logs_nothing_and_does_not_import_structlog() -> None:
    done = run_script(
        "import sys; from ronna_hw.logs import logger; log = logger(device='tracker'); "
        "log.info('connected'); assert 'structlog' not in sys.modules; log.error('lost')"
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_each_line_of_a_kept_log_has_time_level_event_and_source(tmp_path: Path) -> None:
    with keep_log(tmp_path, run="r1"):
        logger(device="tracker").warning("reading lost", missed=3)
    opened, lost = lines_of(tmp_path)
    assert list(lost)[:3] == ["timestamp", "level", "event"]
    assert (lost["level"], lost["event"], lost["device"], lost["missed"]) == (
        "warning",
        "reading lost",
        "tracker",
        3,
    )
    assert opened["run"] == "r1"
    assert "ronna-hw" in opened["versions"]  # type: ignore[operator]


def test_any_value_is_logged_as_valid_json(tmp_path: Path) -> None:
    with keep_log(tmp_path):
        logger(device="robot").info("moved", level=3, error_mm=float("nan"), at=object, path=tmp_path)
    _, moved = lines_of(tmp_path)
    assert (moved["level"], moved["error_mm"], moved["path"]) == ("info", "nan", "[redacted]")


def test_nothing_is_logged_after_the_block_even_when_the_run_failed(tmp_path: Path) -> None:
    handlers = list(logging.getLogger().handlers)
    with pytest.raises(ZeroDivisionError), keep_log(tmp_path):
        raise ZeroDivisionError
    logger(device="tracker").error("too late")
    assert [line["event"] for line in lines_of(tmp_path)] == ["opened"]
    assert logging.getLogger().handlers == handlers


def test_a_level_applies_to_one_logger_and_its_children(tmp_path: Path) -> None:
    with keep_log(tmp_path):
        set_level("debug", "robot")
        set_level("error", "tracker")
        logger(device="robot.master").debug("detail")
        logger(device="tracker").warning("unwanted")
        logger(device="stereo").debug("unwanted")
    assert [line["event"] for line in lines_of(tmp_path)] == ["opened", "detail"]


def test_an_unknown_level_is_refused() -> None:
    with pytest.raises(ValueError, match="expected a level"):
        set_level("loud", "tracker")


def test_the_log_of_a_run_is_bounded_in_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_output, "FILE_BYTES", 2000)
    with keep_log(tmp_path):
        for number in range(200):
            logger(device="tracker").info("frame lost", number=number)
    files = list(tmp_path.iterdir())
    assert len(files) == 1 + log_output.OLD_FILES
    assert sum(file.stat().st_size for file in files) <= 2000 * len(files)
    assert lines_of(tmp_path)[-1]["number"] == 199


def test_a_line_of_many_values_is_cut(tmp_path: Path) -> None:
    with keep_log(tmp_path):
        logger(device="tracker").info(
            "frames lost", numbers=list(range(10**4)), by=dict.fromkeys(range(10**4))
        )
    assert (tmp_path / LOG_FILE).stat().st_size < 10_000


def test_a_full_disk_drops_log_lines_and_stops_nothing(tmp_path: Path) -> None:
    done = run_script(
        "import resource; from pathlib import Path\n"
        "from ronna_hw.log_output import keep_log; from ronna_hw.logs import logger\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        f"with keep_log(Path({str(tmp_path)!r})):\n"
        "    for _ in range(100): logger(device='tracker').info('frame lost')\n"
        "print('done')"
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")
    assert (tmp_path / LOG_FILE).stat().st_size <= 1000


def test_a_missing_log_folder_stops_nothing(tmp_path: Path) -> None:
    with keep_log(tmp_path / "gone"):
        logger(device="tracker").info("connected")


def test_a_child_process_is_logged_from_ready_to_end_without_its_control_token(
    tmp_path: Path,
) -> None:
    ready = "READY " + json.dumps({"control": "tcp://127.0.0.1:5?token=6f1e2b"})
    program = f"import time; print({ready!r}, flush=True); time.sleep(60)"
    with keep_log(tmp_path):
        ChildProcess("ronna-sim theatre", [sys.executable, "-c", program]).stop()
    text = (tmp_path / LOG_FILE).read_text()
    assert [line["event"] for line in lines_of(tmp_path)] == ["opened", "ready", "ended"]
    assert "tcp://127.0.0.1:5?token=" in text
    assert "6f1e2b" not in text


def test_a_library_that_reads_patient_files_is_named_but_its_text_redacted(tmp_path: Path) -> None:
    with keep_log(tmp_path):
        try:
            raise ValueError("DOE^JOHN")
        except ValueError as error:
            logging.getLogger("pydicom.valuerep").exception("invalid PN: %s", error)
        logging.getLogger("distributed").warning("worker lost")
    _, dicom, other = lines_of(tmp_path)
    assert (dicom["library"], dicom["event"]) == ("pydicom.valuerep", "[redacted]")
    assert "DOE" not in str(dicom)  # not in the trace either
    assert other["event"] == "worker lost"


def test_a_warning_is_logged_with_its_location_but_without_its_text() -> None:
    done = run_script(
        "import sys, warnings; from ronna_hw.log_output import show_log; show_log(sys.stderr); "
        "warnings.warn_explicit('DOE^JOHN', UserWarning, 'series.py', 7)"
    )
    assert "series.py:7: UserWarning" in done.stderr
    assert "DOE" not in done.stderr


def test_ignored_warnings_are_not_printed() -> None:
    done = run_script(
        "import logging, warnings; from ronna_hw.command_line.options import set_up_logging; "
        "set_up_logging(False); "
        "warnings.warn('x'); logging.getLogger('pydicom').warning('y')"
    )
    assert done.stderr == ""
