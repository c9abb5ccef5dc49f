"""A killed calibration is resumed and writes its records."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from kills import Killed, killed_at, reopen_run
from user_commands import Commands

from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from procedures.operator.question import Topic
from procedures.workcell.arm_history import MotionKind
from ronna_hw.errors import EXIT_DONE, EXIT_RECOVERY_NEEDED, EXIT_UNCONFIRMED
from sim.world.scene.model import read_scene

pytestmark = [pytest.mark.slow, pytest.mark.hazard(2), pytest.mark.timeout(500)]

MINI = ("--sim", "--scene", "mini", "--seed", "3")
FRAME = ("ronna-procedure", ("calibrate", "tracker-frame", *MINI, "--looks", "15", "--validation", "5"))
TIP = ("ronna-procedure", ("calibrate", "tool-tip", *MINI))
HEAD = ("ronna-stereo", ("calibrate", *MINI, "--visits", "2"))
ARM = ("ronna-arm", ("calibrate", *MINI, "--looks", "60", "--validation", "12"))
LOOKS = '"what":"settle"'  # the arm is on its way to a look
READS = '"task":"dials"'  # the divot was raised to the tip


def killed(commands: Commands, calibration: tuple[str, tuple[str, ...]], out: Path, says: str) -> Killed:
    program, arguments = calibration
    return killed_at(commands, arguments, out, says, program)


@pytest.mark.parametrize(
    ("calibration", "says"),
    [(FRAME, LOOKS), (TIP, LOOKS), (TIP, READS), (HEAD, LOOKS), (ARM, LOOKS)],
    ids=["frame", "tip at the ball", "tip at the divot", "head", "arm"],
)
def test_a_killed_calibration_can_be_resumed_and_writes_its_records(
    commands: Commands, tmp_path: Path, calibration: tuple[str, tuple[str, ...]], says: str
) -> None:
    left = killed(commands, calibration, tmp_path, says)
    payload = reopen_run(commands, left)
    records = tomllib.loads((left.folder / "calibration.toml").read_text())["calibration"]
    assert payload["calibration"] in [record["identifier"] for record in records.values()]
    for command, code in (("verify", EXIT_UNCONFIRMED), ("replay", EXIT_DONE)):
        done = commands.run("ronna-procedure", command, str(left.folder))
        assert done.returncode == code, done.stdout + done.stderr
    again = commands.run("ronna-procedure", "resume", str(left.folder), "--json")
    assert json.loads(again.stdout) == payload
    if calibration is TIP:
        scene = read_scene(left.folder / "theatre" / "scene.json")
        designed = scene.mount.flange_from_tool_nominal.translation_mm
        true = np.add(designed, scene.mount.tool_from_tip_true.translation_mm)
        assert np.linalg.norm(records["tool_tip"]["flange_from_tool"]["translation_mm"] - true) <= 0.05


def test_a_guide_left_at_the_divot_is_withdrawn_only_after_acceptance(
    commands: Commands, tmp_path: Path
) -> None:
    left = killed(commands, TIP, tmp_path, READS)
    refused = commands.run("ronna-procedure", "home", str(left.folder))
    assert refused.returncode == EXIT_RECOVERY_NEEDED, refused.stderr
    done = commands.run("ronna-procedure", "home", str(left.folder), "--accept", "--json")
    assert json.loads(done.stdout) == {"run": left.folder.name, "home": True, "moved": True}
    lines = tuple(read_journal(left.folder / JOURNAL_FILE))[len(left.journal) :]
    motions = [line for line in lines if line["entry"] == Entry.MOTION]
    assert motions[-1]["what"] == MotionKind.HOME
    assert {line["what"] for line in motions} <= {MotionKind.HOME, MotionKind.BACK}
    lowered = next(line for line in lines if line.get("topic") == Topic.INSTRUMENT_OUT)
    assert lines.index(lowered) < lines.index(motions[0])
    assert reopen_run(commands, left)["calibration"]
