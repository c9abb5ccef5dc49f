"""`make demo` shows how far its installation is, and what pip said if it fails."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

from tools.setup.install_lock import Progress, follow

SCRIPT = Path(__file__).resolve().parents[3] / "tools" / "setup" / "install_lock.py"
PRINTED = (
    "Processing /wheels/aiofiles-25.1.0-py3-none-any.whl (from -r requirements/run.txt (line 1))\n",
    "Collecting numpy==2.2.0 (from -r requirements/run.txt (line 60))\n",
    "  Downloading numpy-2.2.0.whl (16 MB)\n",
    "Collecting scipy==1.16.0 (from -r requirements/run.txt (line 100))\n",
    "Installing collected packages: aiofiles, numpy, scipy\n",
)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_shows_the_share_and_the_package_and_a_log_a_line_for_each_quarter(tmp_path: Path) -> None:
    terminal, log = Terminal(), io.StringIO()
    for stream in (terminal, log):
        assert follow(PRINTED, 100, tmp_path, Progress(stream)) == list(PRINTED)
    assert "  60%  numpy" in terminal.getvalue()
    assert log.getvalue().splitlines() == ["  fetching 0%", "  fetching 50%", "  fetching 100%"]


def test_what_pip_said_is_shown_if_it_fails(tmp_path: Path) -> None:
    lock = tmp_path / "lock.txt"
    lock.write_text(f"no-such-package==1.0 --hash=sha256:{'0' * 64}\n")
    done = subprocess.run([sys.executable, SCRIPT, lock, "--no-index"], capture_output=True, text=True)
    assert done.returncode == 1
    assert "No matching distribution found for no-such-package" in done.stderr
