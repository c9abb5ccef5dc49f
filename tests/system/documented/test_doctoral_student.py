"""A doctoral student's day, by the pages alone: own methods in campaigns, bounds, raw readings in Python."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from documented import commands_of, run_all, write_files
from user_commands import Commands

OWN, RAW = "docs/how-to/research/own-methods.md", "docs/how-to/research/raw-readings.md"
LIMIT_S = 300.0  # of a command on a busy computer


def tables_of(folder: Path) -> list[dict[str, object]]:
    """Every row of a campaign, by the names of its columns."""
    tables = json.loads((folder / "results.json").read_text(encoding="utf-8"))["tables"]
    return [dict(zip(one["columns"], row, strict=True)) for one in tables for row in one["rows"]]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_own_methods_are_compared_with_ours_with_bounds_and_a_run_is_read_in_python(
    commands: Commands, tmp_path: Path
) -> None:
    write_files(OWN, tmp_path)
    write_files(RAW, tmp_path)
    campaigns = commands_of(OWN)
    assert [line.split()[1] for line in campaigns] == [
        "correspondence",
        "registration",
        "localization",
        "strategies",
    ]
    run_all(campaigns, commands, tmp_path, LIMIT_S)

    pairing = [row for row in tables_of(tmp_path / "pairing") if row.get("fiducials") == 8]
    assert {str(row["method"]) for row in pairing} == {"my_pairing:by_distances", "clique + planned count"}
    assert {row["false, 95 %"] for row in pairing if row["false %"] == 0.0} == {"at most 0.99"}  # of 300
    fits = [row for row in tables_of(tmp_path / "registration") if row.get("method")]
    assert {"ours, equal weights", "my_registration:with_weights"} <= {str(row["method"]) for row in fits}
    assert all(" to " in str(row["TRE, 95 %"]) for row in fits)
    found = {row["method"]: row for row in tables_of(tmp_path / "localization") if row.get("method")}
    assert float(str(found["my_localizer:centroids"]["rms µm"])) > float(str(found["combined"]["rms µm"]))
    trials = {row["strategy"] for row in tables_of(tmp_path / "strategies") if "mean, 95 %" in row}
    assert {"my_strategy:Halfway", "ocs"} <= trials

    run_all(commands_of(RAW)[:2], commands, tmp_path, LIMIT_S)
    (run,) = (tmp_path / "runs").iterdir()
    kept = sorted(path.relative_to(run / "raw") for path in (run / "raw").rglob("*.*"))
    assert kept == sorted(path.relative_to(tmp_path / "raw") for path in (tmp_path / "raw").rglob("*.*"))
    seen, straight = (
        subprocess.run(
            [sys.executable, file], cwd=tmp_path, capture_output=True, text=True, timeout=LIMIT_S, check=True
        ).stdout.splitlines()
        for file in ("look.py", "straight.py")
    )
    assert any(line.startswith("global_localization tracker ") for line in straight)
    assert any(line.startswith("global_localization robot_frame: 60 frames, sd ") for line in seen)
    pictures = [one for one in kept if one.suffix == ".png"]
    assert sum(line.startswith("pictures/") for line in seen) == len(pictures) > 10
    whole = commands.run("ronna-procedure", "verify", str(run))
    assert whole.returncode == 0, whole.stderr
