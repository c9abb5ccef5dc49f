"""Ctrl-C reaches the whole foreground group of a terminal: the processes that we start never see it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from ronna_hw.host.child_process import ChildNotReady, ChildProcess
from ronna_hw.host.process import describe_exit

GROUP = """
import os, signal, subprocess, threading, time
signal.signal(signal.SIGINT, lambda *_: None)  # a pause was asked for: this program goes on

class Interrupted(subprocess.Popen):
    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        os.killpg(0, signal.SIGINT)

def hammer():
    while True:
        os.killpg(0, signal.SIGINT)
        time.sleep(0.0002)

"""
AT_ITS_START = GROUP + "subprocess.Popen = Interrupted\n"
LINK = """
from dataclasses import replace
from drivers.kuka_rsi.connections import start_link
from rsi_stand import SETTINGS
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.network import own_udp_endpoint
port = parse_endpoint(own_udp_endpoint()).port
own = replace(SETTINGS, port=port, parent_pid=os.getpid(), heartbeat_limit_s=10.0)
link = start_link(own, 60.0)
print(link.state.phase.name)
os.killpg(0, signal.SIGINT)
time.sleep(0.1)  # nothing to await: the link is to outlive the signal
print(link.alive)
link.close()
"""
RECEIVER = """
from drivers.basler_stereo.stream.receiver import ReceiverProcess
receiver = ReceiverProcess()
os.killpg(0, signal.SIGINT)
receiver._orders.close()
print(receiver._process.wait(60))
"""
DECODER = """
import json, numpy, tempfile
from pathlib import Path
from procedures.imaging.dicom.frame_decoder import FrameDecoder, NotDecoded
with FrameDecoder() as decoder, tempfile.NamedTemporaryFile() as nothing:
    try:
        decoder.decode(Path(nothing.name))
    except NotDecoded as refused:
        print("gave up" in str(refused))
"""
COMMAND = """
from ronna_hw.host.child_process import run_command
print(run_command("sleep", ["sleep", "0.1"], 60).returncode)
"""
MANY_COMMANDS = """
from ronna_hw.host.child_process import run_command
threading.Thread(target=hammer, daemon=True).start()
print({run_command("true", ["true"], 60).returncode for _ in range(50)})
"""


def _printed(program: str) -> list[str]:
    """What a program prints that leads a group of its own, as at a terminal."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", program],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        start_new_session=True,
        timeout=150,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split("\n")[:-1]


@pytest.mark.hazard(30)
@pytest.mark.parametrize(
    ("program", "printed"),
    [
        pytest.param(AT_ITS_START + LINK, ["IDLE", "True"], id="real-time process"),
        pytest.param(AT_ITS_START + RECEIVER, ["0"], id="receiver"),
        pytest.param(AT_ITS_START + DECODER, ["False"], id="decoder"),
        pytest.param(AT_ITS_START + COMMAND, ["0"], id="command"),
        pytest.param(GROUP + MANY_COMMANDS, ["{0}"], id="before its first instruction"),
    ],
)
def test_an_interrupt_at_the_start_of_a_process_reaches_its_parent_only(
    program: str, printed: list[str]
) -> None:
    assert _printed(program) == printed


def test_the_end_of_a_process_is_named_by_its_signal_or_its_exit_code() -> None:
    assert describe_exit(3) == "exit code 3"
    assert describe_exit(-signal.SIGINT) == "killed by SIGINT"
    assert describe_exit(-(signal.SIGRTMIN + 5)) == f"killed by signal {signal.SIGRTMIN + 5}"


def test_a_child_killed_by_a_signal_before_it_is_ready_says_so() -> None:
    program = "import os; os.write(2, b'last words'); os.kill(os.getpid(), 9)"
    with pytest.raises(ChildNotReady, match="ended before it was ready: killed by SIGKILL / last words"):
        ChildProcess("killed", [sys.executable, "-c", program])
