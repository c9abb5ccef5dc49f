"""A module run in a fork of its parent behaves like a program of its own."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

# Forked by a program of its own: this one has threads.
PARENT = """
import json, os, subprocess, sys
from ronna_hw.host.child_process import ChildProcess
from ronna_hw.host.forked_process import ForkedProcess

os.open(os.curdir, os.O_RDONLY)
forked = ForkedProcess("forked_module", *sys.argv[1:])
child = ChildProcess("forked", forked.args, started=forked)
number = child.process.pid
try:
    child.process.wait(0.01)
    early = False
except subprocess.TimeoutExpired:
    early = child.alive
listed = open(f"/proc/{number}/cmdline").read().split("\\0")
child.stop()
print(json.dumps({
    "ready": child.ready, "messages": child.messages, "listed": listed, "given": forked.args,
    "code": forked.returncode, "early": early, "parent": os.getpid(),
}))
"""
CHILD = """
import json, os, signal, sys
from ronna_hw.host.process import Parent

signal.alarm(20)
if sys.argv[1:] == ["fail"]:
    raise LookupError("nothing there")
if sys.argv[1:] == ["refuse"]:
    sys.stderr.write("refused\\n")
    sys.exit(4)
sys.stderr.write("begun\\n")
facts = {
    "leads_session": os.getsid(0) == os.getpid(),
    "parent": Parent.noted.pid,
    "parent_is_gone": Parent.noted.is_gone,
    "input": sys.stdin.read(),
    "files": [int(one) for one in os.listdir("/proc/self/fd")],
    "on_terminate": signal.getsignal(signal.SIGTERM) == signal.SIG_DFL,
    "name": __name__,
}
print("READY", json.dumps(facts), flush=True)
signal.pause()
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of the module that is run in a fork."""
    (tmp_path / "forked_module.py").write_text(CHILD)
    return tmp_path


def _fork(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", PARENT, *words],
        cwd=folder, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


def test_a_forked_module_has_its_own_command_line_session_streams_and_signals(folder: Path) -> None:
    done = _fork(folder, "word", "--option=1")
    said: dict[str, Any] = json.loads(done.stdout)
    assert said["listed"] == [*said["given"], ""]
    assert said["given"][-3:] == ["forked_module", "word", "--option=1"]
    facts = said["ready"]
    assert facts["leads_session"]
    assert facts["on_terminate"]
    assert facts["input"] == ""
    assert facts["name"] == "__main__"
    assert sorted(facts["files"]) == [0, 1, 2, 3]  # the last is that of the list itself
    assert (facts["parent"], facts["parent_is_gone"]) == (said["parent"], False)
    assert said["messages"] == ["begun"]
    assert said["early"]
    assert said["code"] == -signal.SIGTERM


@pytest.mark.parametrize(("word", "message"), [("refuse", "refused"), ("fail", "LookupError: nothing there")])
def test_a_forked_module_that_ends_early_is_reported_with_its_last_message(
    folder: Path, word: str, message: str
) -> None:
    done = _fork(folder, word)
    assert f"{message}. Run the command alone" in done.stderr
