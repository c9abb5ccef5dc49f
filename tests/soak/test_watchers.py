"""Twenty terminals follow a case in real time, and one of them hangs: the arm's link is unaffected."""

import json
import signal
import subprocess
from pathlib import Path

import pytest
from run_folders import records_of
from user_commands import Commands

pytestmark = [pytest.mark.soak, pytest.mark.timeout(2400)]

CASE = ("step", "--sim", "--scene", "mini", "--seed", "3", "--speed", "1")
BEFORE_ALL_MOTIONS, LAST = "path_check", "confirmation:T1"
WATCHERS, LIMIT_S = 20, 300.0
TIMES = 3  # other work on the computer only adds late cycles: the fewest are the case's own


def order(case: subprocess.Popen[str], last: str) -> None:
    """Run the case up to a step."""
    assert case.stdin is not None
    assert case.stdout is not None
    case.stdin.write(f"to {last}\n")
    case.stdin.flush()
    assert any(line.startswith(f"done {last}") for line in case.stdout), f"{last} was not done"


def late_cycles(commands: Commands, out: Path, watchers: int) -> int:
    """Of a case that so many watch before anything moves, the first of whom is halted."""
    case = commands.start("ronna-procedure", *CASE, "--out", str(out), stdin=subprocess.PIPE)
    order(case, BEFORE_ALL_MOTIONS)
    (folder,) = out.iterdir()
    watching = [commands.start("ronna-procedure", "watch", str(folder), "--json") for _ in range(watchers)]
    for one in watching:
        assert one.stdout is not None
        assert json.loads(one.stdout.readline())["what"]
    for one in watching[:1]:
        one.send_signal(signal.SIGSTOP)
    order(case, LAST)
    _, messages = case.communicate("quit\n", timeout=LIMIT_S)
    assert case.returncode == 0, messages
    for one in watching[:1]:
        one.send_signal(signal.SIGCONT)
    for one in watching:
        seen, _ = one.communicate(timeout=LIMIT_S)
        assert json.loads(seen.splitlines()[-1])["what"]
    links = [link for record in records_of(folder) if isinstance(link := record.payload.get("link"), dict)]
    assert len(links) > 1  # one for each session of the robot link
    return sum(int(link["late_cycles"]) + int(link["lost_cycles"]) for link in links)


def test_twenty_watchers_one_of_them_halted_do_not_change_the_late_cycles_of_a_case(
    commands: Commands, tmp_path: Path
) -> None:
    pairs = [
        [late_cycles(commands, tmp_path / f"{watchers}-{time}", watchers) for watchers in (0, WATCHERS)]
        for time in range(TIMES)
    ]
    alone, watched = map(min, zip(*pairs, strict=True))
    assert watched <= alone, pairs
