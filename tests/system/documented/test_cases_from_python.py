"""The page on cases in Python works as written, with fewer of them."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs/how-to/research/cases-from-python.md"
FEWER = {"seed=range(20)": "seed=range(1)", "seed=range(3)": "seed=range(1)"}


@pytest.mark.slow  # four mini cases
def test_the_page_on_cases_in_python_works_as_written(tmp_path: Path) -> None:
    program = "\n".join(re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL))
    for many, few in FEWER.items():
        assert many in program
        program = program.replace(many, few)
    script = tmp_path / "page.py"
    script.write_text(program, encoding="utf-8")
    line = [sys.executable, "-W", "error::RuntimeWarning", str(script)]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=300.0, check=False)
    assert done.returncode == 0, done.stderr
    assert "registration:T1 predicted target error" in done.stdout
    assert re.search(r"^improved +1\.0 .*^ocs +1\.0 ", done.stdout, re.DOTALL | re.MULTILINE)
    assert "distance_mm" in done.stdout
    assert "covered by a fault" in done.stdout
    assert (tmp_path / "sweeps" / "strategies" / "points.jsonl").exists()
