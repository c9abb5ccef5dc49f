"""The tail of a log, as the page shows it."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from console.panels.results import TAIL_BYTES, LogTail, log
from ronna_hw.log_output import LOG_FILE


def line(level: str, event: str, **more: object) -> str:
    return json.dumps({"timestamp": "2026-11-21T10:21:05.1Z", "level": level, "event": event, **more}) + "\n"


def test_a_grown_log_is_read_again_and_an_incomplete_line_waits(tmp_path: Path) -> None:
    tail = LogTail(tmp_path)
    assert tail.lines() == ()
    with (tmp_path / LOG_FILE).open("a") as file:
        file.write(line("info", "step begins", step="ct_import") + line("error", "step failed")[:20])
    assert tail.lines() == ("10:21:05 info step begins: step ct_import",)
    with (tmp_path / LOG_FILE).open("a") as file:
        file.write(line("error", "step failed")[20:])
    assert tail.lines()[-1] == "10:21:05 error step failed"


def test_only_whole_lines_from_the_end_of_a_long_log_are_shown(tmp_path: Path) -> None:
    (tmp_path / LOG_FILE).write_text("".join(line("info", f"event {number:04}") for number in range(2000)))
    shown = LogTail(tmp_path).lines()
    assert shown[-1].endswith("event 1999")
    assert 0 < len(shown) * len(line("info", "event 0000")) <= TAIL_BYTES
    assert all(one.startswith("10:21:05 info event ") for one in shown)


@pytest.mark.timeout(20)
def test_a_pipe_or_a_link_in_place_of_the_log_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / LOG_FILE)
    assert LogTail(tmp_path).lines() == ()
    (tmp_path / LOG_FILE).rename(tmp_path / "pipe")
    (tmp_path / "another").write_text(line("info", "of another run"))
    (tmp_path / LOG_FILE).symlink_to("another")
    assert LogTail(tmp_path).lines() == ()


def test_a_line_that_is_not_json_is_omitted_and_other_text_is_escaped(tmp_path: Path) -> None:
    (tmp_path / LOG_FILE).write_text("torn\n[1]\n" + line("warning", "<script>"))
    shown = log(LogTail(tmp_path).lines())
    assert "&lt;script" in shown
    assert 'class="warn"' in shown
    assert "torn" not in shown
