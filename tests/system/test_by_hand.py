"""A theatre started by hand, with the procedure on its file and a person who answers."""

import json
import os
import pty
import re
import select
import subprocess
import time
from pathlib import Path

import pytest
from run_folders import await_motion_in, run_folder
from user_commands import Commands, in_this_process, one_error

from procedures.engine.journal import JOURNAL_FILE, Entry, read_journal
from ronna_hw.errors import EXIT_REFUSED
from sim.cli import app as ronna_sim

CASE_S = 100.0
PROMPT = r"Type (yes or no|done|how many mm|the patient's identifier)[^:]*: "
PATIENT = "mini-4"  # scene and seed


def answer(asked: str, text: str) -> str:
    """What a person types who has read the text."""
    if asked == "how many mm":
        return re.findall(r"moves\s+(\d+)\s+mm", text)[-1]
    return PATIENT if asked.startswith("the patient") else asked.split()[0]


@pytest.mark.slow
def test_a_person_confirms_each_value_and_exchanges_the_tool(commands: Commands, tmp_path: Path) -> None:
    scene = ("--scene", "mini", "--seed", "4")
    assert commands.run("ronna-sim", "phantom", *scene, "--out", str(tmp_path / "patient")).returncode == 0
    theatre = commands.start("ronna-sim", "theatre", *scene, "--out", str(tmp_path / "theatre"))
    assert theatre.stdout is not None
    ready = json.loads(theatre.stdout.readline().removeprefix("READY "))
    control = ready["endpoints"]["control"]
    primary, secondary = pty.openpty()
    runs = str(tmp_path / "runs")
    line = ("run", "--config", ready["file"], "--case", str(tmp_path / "patient"), "--out", runs)
    process = subprocess.Popen(
        commands.line("ronna-procedure", *line),
        env={**commands.environment, "TERM": "xterm"},
        stdin=secondary,
        stdout=secondary,
        stderr=secondary,
    )
    os.close(secondary)
    text, answered, mounted_at, deadline = "", 0, 0, time.monotonic() + CASE_S
    try:
        while process.poll() is None and time.monotonic() < deadline:
            if not select.select([primary], [], [], 0.2)[0]:
                continue
            try:
                text += os.read(primary, 65536).decode(errors="replace")
            except OSError:
                break
            asked = re.findall(PROMPT, text)
            if len(asked) > answered:
                answered += 1
                if text.rfind("Mount the surgical guide") > mounted_at:
                    mounted_at = len(text)
                    assert commands.run("ronna-sim", "mount", "2", "--control", control).returncode == 0
                os.write(primary, answer(asked[-1], text).encode() + b"\n")
        assert process.wait(5) == 0, text[-1500:]
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        os.close(primary)
        theatre.terminate()
        theatre.communicate(timeout=5)
    assert "predicted error of" in text


@pytest.mark.slow
@pytest.mark.hazard(32)
def test_after_an_emergency_stop_it_is_acknowledged_by_name_and_the_arm_goes_home(
    commands: Commands, tmp_path: Path
) -> None:
    scene = ("--scene", "mini", "--seed", "4")
    assert commands.run("ronna-sim", "phantom", *scene, "--out", str(tmp_path / "patient")).returncode == 0
    theatre = commands.start("ronna-sim", "theatre", *scene, "--out", str(tmp_path / "theatre"))
    assert theatre.stdout is not None
    ready = json.loads(theatre.stdout.readline().removeprefix("READY "))
    control = ("--control", ready["endpoints"]["control"])
    (tmp_path / "answers.toml").write_text('default = "first"\n')
    answers = ("--answers", str(tmp_path / "answers.toml"))
    case = ("--config", ready["file"], "--case", str(tmp_path / "patient"), "--out", str(tmp_path / "runs"))
    try:
        running = commands.start("ronna-procedure", "run", *case, *answers)
        await_motion_in(tmp_path / "runs", "relocalization:T1")
        commands.run("ronna-sim", "fault", "robot emergency stop", *control)
        running.communicate(timeout=CASE_S)
        run = str(run_folder(tmp_path / "runs"))
        home = ("ronna-procedure", "home", run, *answers)
        acknowledge = ("ronna-procedure", "acknowledge", run, "--by", "A. Nurse", "--json")
        for pressed in (commands.run(*home), commands.run(*acknowledge)):
            assert pressed.returncode == EXIT_REFUSED
            assert "emergency stop is active" in pressed.stderr
        commands.run("ronna-sim", "fault", "--clear", *control)
        released = commands.run(*home)
        assert "ronna-procedure acknowledge" in released.stderr
        assert list(json.loads(commands.run(*acknowledge).stdout)["acknowledged"]) == ["arm"]
        assert commands.run(*home).stdout == "the arm is home\n"
    finally:
        theatre.terminate()
        theatre.communicate(timeout=5)
    line = next(one for one in read_journal(Path(run) / JOURNAL_FILE) if one["entry"] == Entry.ACKNOWLEDGED)
    assert line["by"] == "A. Nurse"


def test_a_theatre_that_is_not_there_cannot_exchange_its_tool() -> None:
    done = in_this_process(ronna_sim, "mount", "2", "--control", "tcp://127.0.0.1:9?token=x")
    assert done.returncode == 4
    assert one_error(done.stderr)[0].startswith("CTL-001")
