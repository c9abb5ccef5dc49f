"""Hazard 25: a whole case with cameras that lose packets reaches its target."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from run_folders import records_of
from user_commands import Commands

LARGEST_ERROR_MM = 1.5


@pytest.mark.hazard(25)
@pytest.mark.slow
@pytest.mark.timeout(180)
@pytest.mark.parametrize(
    "faults",
    [
        "when step == relocalization: camera drop 3 %\n",
        "when step == relocalization: camera lose left 1 % for 4 s\n"
        "when step == relocalization: camera forget left for 4 s\n",
    ],
    ids=["packets are sent again", "the left camera has forgotten them"],
)
def test_a_case_whose_cameras_lose_packets_reaches_its_target(
    commands: Commands, tmp_path: Path, faults: str
) -> None:
    script = tmp_path / "faults.txt"
    script.write_text(faults)
    options = ("--scene", "mini", "--seed", "3", "--faults", str(script), "--out", str(tmp_path / "runs"))
    done = commands.run("ronna-procedure", "run", "--sim", "--json", *options, timeout_s=150)
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
    folder = tmp_path / "runs" / outcome["run"]
    (fine,) = [record for record in records_of(folder) if record.kind == "relocalization"]
    assert len(fine.payload["fiducials"]) == outcome["markers"]
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    (streams,) = [line["streams"] for line in lines if line.get("device") == "stereo" and "streams" in line]
    assert sum(stream["resend_requests"] + stream["incomplete_frames"] for stream in streams) > 0
