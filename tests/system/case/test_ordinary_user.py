"""A whole case as a computer user without special rights and without a home folder."""

from __future__ import annotations

import json
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from user_commands import Commands

import procedures

NOBODY = 65534
NONE = "-all"  # of the capabilities: also a file that only root can read is refused
CASE = ("run", "--sim", "--scene", "mini", "--seed", "3", "--json")


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """Open to everybody; pytest's own is root's alone."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o777)
        yield Path(folder)


@pytest.fixture
def nobodys(commands: Commands, open_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Commands:
    """Commands that run as nobody."""
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    here = Path(sys.executable).parent
    needed = [here.parent, Path(sys.base_prefix), Path(procedures.__file__).parents[1]]
    if not all(map(open_to_others, needed)):
        pytest.skip("interpreter or sources are closed to other users")
    if shutil.which("setpriv") is None or shutil.which("unshare") is None:
        pytest.skip("no setpriv or unshare on this computer")
    capabilities = [f"--{kind}={NONE}" for kind in ("inh-caps", "ambient-caps", "bounding-set")]
    become = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", *capabilities]
    become = [*shown_to_others(needed, open_folder / "staging"), *become]
    monkeypatch.setattr(commands, "line", lambda name, *rest: [*become, str(here / name), *rest])
    commands.environment.pop("HOME", None)
    return commands


def open_to_others(folder: Path) -> bool:
    return folder.stat().st_mode & 0o005 == 0o005


def shown_to_others(folders: Sequence[Path], staging: Path) -> list[str]:
    """A command's first words, for which each folder can be reached although one above it is root's alone.

    The closed folder is covered by an empty one, in which only those folders are mounted, unchanged.
    """
    closed = {next((up for up in reversed(one.parents) if not open_to_others(up)), None) for one in folders}
    if closed == {None}:
        return []
    behind = {one: staging / str(n) for n, one in enumerate(folders) if closed & {*one.parents}}
    lines = []
    for folder, aside in behind.items():
        aside.mkdir(parents=True)
        lines.append(f"mount --bind {folder} {aside}")
    lines += [f"mount -t tmpfs -o mode=755 none {folder}" for folder in closed if folder is not None]
    lines += [f"mkdir -p {folder}; mount --bind {aside} {folder}" for folder, aside in behind.items()]
    return ["unshare", "--mount", "sh", "-ec", "; ".join([*lines, 'exec "$@"']), "sh"]


@pytest.mark.slow
def test_an_unprivileged_user_runs_a_whole_case_and_keeps_it_private(
    nobodys: Commands, open_folder: Path
) -> None:
    out = open_folder / "runs"
    done = nobodys.run("ronna-procedure", *CASE, "--out", str(out))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["outcome"] == "done"
    made = [out, *out.rglob("*")]
    assert {path.stat().st_uid for path in made} == {NOBODY}
    assert [path for path in made if stat.S_IMODE(path.stat().st_mode) & 0o077] == []
