"""A whole case as a computer user without special rights and without a home folder."""

from __future__ import annotations

import json
import os
import shutil
import stat
import sys
import tempfile
from pathlib import Path

import pytest
from user_commands import Commands

NOBODY = 65534
READS_ALL = "-all,+dac_read_search"  # only to read the interpreter and the sources, wherever root keeps them
CASE = ("run", "--sim", "--scene", "mini", "--seed", "3", "--json")


@pytest.fixture
def nobodys(commands: Commands, monkeypatch: pytest.MonkeyPatch) -> Commands:
    """Commands that run as nobody."""
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    setpriv = shutil.which("setpriv")
    if setpriv is None:
        pytest.skip("no setpriv on this computer")
    capabilities = [f"--{kind}={READS_ALL}" for kind in ("inh-caps", "ambient-caps", "bounding-set")]
    become = [setpriv, f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", *capabilities]
    here = Path(sys.executable).parent
    monkeypatch.setattr(commands, "line", lambda name, *rest: [*become, str(here / name), *rest])
    commands.environment.pop("HOME", None)
    return commands


@pytest.mark.slow
def test_an_unprivileged_user_runs_a_whole_case_and_keeps_it_private(nobodys: Commands) -> None:
    with tempfile.TemporaryDirectory() as open_folder:  # pytest's own is root's alone
        Path(open_folder).chmod(0o777)
        out = Path(open_folder) / "runs"
        done = nobodys.run("ronna-procedure", *CASE, "--out", str(out))
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["outcome"] == "done"
        made = [out, *out.rglob("*")]
        assert {path.stat().st_uid for path in made} == {NOBODY}
        assert [path for path in made if stat.S_IMODE(path.stat().st_mode) & 0o077] == []
