"""The controller driven by urx, a third-party client that reads robot states of version 3.2 on port 30002.

It is LGPL software: a program of its own, whose code none of ours imports.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from ur_clients import UrCell

pytestmark = pytest.mark.skipif(find_spec("urx") is None, reason="left out: urx 0.11.0 as a client")

LIMIT_S = 60.0
SIX_DIGITS = 1e-5  # with which urx writes numbers
CLIENT = """
import json, sys, time
from urx.urrobot import URRobot

robot = URRobot(sys.argv[1])
found = {}

def eventually(read, wanted):
    until = time.monotonic() + 5.0
    while read() != wanted and time.monotonic() < until:
        time.sleep(0.01)
    return read()

start = robot.getj()
goal = [start[0] + 0.1, *start[1:]]
robot.movej(goal, acc=10, vel=2)
found["joints"], found["goal"] = robot.getj(), goal
line = robot.getl()
line[2] += 0.02
robot.movel(line, acc=5, vel=0.5)
found["pose"], found["line"] = robot.getl(), line
found["rests"] = eventually(robot.is_program_running, False)
robot.send_program("set_digital_out(1, True)")  # its own call writes a syntax that no manual has
found["output"] = eventually(lambda: robot.get_digital_out(1), 1)
found["powered"] = robot.is_running()
robot.close()
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def found() -> Iterator[dict[str, Any]]:
    with ExitStack() as stack:
        cell = UrCell(stack, "--model", "ur5", "--set", "robot_mode_bytes=46", number=2)
        client = subprocess.run(
            (sys.executable, "-c", CLIENT, cell.address),
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            cwd=Path.home(),
        )
        assert client.returncode == 0, client.stderr
        yield json.loads(client.stdout.splitlines()[-1])


def test_it_moves_to_joints_and_along_a_line(found: dict[str, Any]) -> None:
    assert found["joints"] == pytest.approx(found["goal"], abs=SIX_DIGITS)
    assert found["pose"][:3] == pytest.approx(found["line"][:3], abs=SIX_DIGITS)


def test_it_reads_that_the_arm_is_powered_and_its_program_has_ended(found: dict[str, Any]) -> None:
    assert found["powered"]
    assert found["rests"] is False


def test_it_switches_an_output(found: dict[str, Any]) -> None:
    assert found["output"] == 1
