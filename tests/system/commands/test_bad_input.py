"""Each bad input gives one clear message with its code and an action, and the documented exit code."""

import resource
import subprocess
from pathlib import Path

import pytest
from user_commands import Commands, in_this_process, one_error

from procedures.cli.procedure import app as ronna_procedure
from ronna_hw.errors import EXIT_FAILED, EXIT_USAGE


def _refused(done: subprocess.CompletedProcess[str], code: str, exit_code: int) -> str:
    line = " ".join(one_error(done.stderr))
    assert code in line
    assert done.returncode == exit_code, line
    return line


def test_a_read_only_output_folder_is_refused() -> None:
    _refused(_run_mini(Path("/proc/self/runs")), "CLI-00", EXIT_FAILED)


@pytest.mark.parametrize(
    ("option", "content", "code", "said"),
    [
        ("--faults", "at 3 s: robot dorp 2 %\n", "SIM-003", "Did you mean: at 3 s: robot drop 2 %?"),
        ("--scene", "schema = 1\nname = 'mine'\n", "PRO-013", "head: is missing"),
    ],
)
def test_a_refused_theatre_leaves_no_run_and_gives_the_reason(
    tmp_path: Path, option: str, content: str, code: str, said: str
) -> None:
    (path := tmp_path / "given.toml").write_text(content)
    words = ("run", "--sim", option, path, "--out", tmp_path / "new" / "runs")
    assert said in _refused(in_this_process(ronna_procedure, *words), code, EXIT_USAGE)
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
