"""A simulated theatre starts at once; what the steps need is imported while it gets ready."""

import subprocess
import sys
from pathlib import Path

SCRIPT = """
import sys
from procedures.runs.simulated_theatre import SimulatedTheatre

def started(*_arguments, **_options):
    heavy = {"numpy", "scipy", "cv2", "pydicom", "matplotlib", "procedures.engine.engine"}
    print(*heavy & set(sys.modules))
    raise SystemExit(0)

SimulatedTheatre.__init__ = started
from procedures.cli.procedure import main
main()
"""


def test_a_simulated_theatre_starts_before_anything_heavy_is_imported(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SCRIPT, "run", "--sim", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()) == (0, []), done.stderr
