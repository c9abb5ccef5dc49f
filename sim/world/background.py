"""Simulators in the background: start, hand over once ready, and stop.

The starting command waits for READY and passes on any failure. Until then the simulator ends with it like any
other child; from then on it belongs to nobody, and the register names it.
"""

from __future__ import annotations

import os
import signal
import sys
import time

import typer

from ronna_hw.command_line.terminal import say, tell
from ronna_hw.host.child_process import ChildNotReady, ChildProcess, command, descendants_of, kill_all
from ronna_hw.host.process import Parent
from sim.errors import NOT_RUNNING
from sim.world.running import LOG, RunningSimulator, find_running, register_folder

STOP_LIMIT_S = 5.0  # a theatre saves its world and ends its devices within 3 s
POLL_S = 0.02
_MARK = "RONNA_SIM_BACKGROUND"  # in the environment of the process that is to run in the background
IN_BACKGROUND = os.environ.pop(_MARK, None) is not None  # its own children are not told


class DaemonState:
    """Daemon state."""

    done = False


def start_in_background(device: str) -> bool:
    """Start this very command in the background; print its READY line and how to stop it.

    If it fails to start, its message and exit code become those of this command. Return False if this process
    is the one in the background.
    """
    if IN_BACKGROUND:
        return False
    os.environ[_MARK] = "1"
    child = ChildProcess(f"ronna-sim {device}", command("sim.cli", *sys.argv[1:]), timeout_s=None)
    try:
        line = child.await_ready()
    except ChildNotReady:
        if (code := child.process.returncode) <= 0 or not child.messages:
            raise
        for message in child.messages:
            tell(message)
        raise typer.Exit(code) from None
    except BaseException:  # interrupted: nothing is left behind
        child.stop()
        raise
    import json

    say(f"READY {json.dumps(line)}")
    running = find_running(str(child.process.pid))
    tell(f"{running.name} runs in the background (pid {running.pid}); its messages go to {running.log}")
    tell(f'its variables: eval "$(ronna-sim env {running.argument})"')
    tell(f"to stop it: ronna-sim stop {running.argument}")
    return True


def hand_over() -> None:
    """Let this process outlive its parent, with its messages in a file. Call it just before READY."""
    log = os.open(
        register_folder() / f"{os.getpid()}{LOG}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600
    )
    os.dup2(log, sys.stderr.fileno())
    os.close(log)
    DaemonState.done = not Parent.noted.is_gone  # else nobody would tell the user of it


def leave_output() -> None:
    """Close the output that the starting command reads. Call it just after READY."""
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())


def stop(running: RunningSimulator) -> None:
    """Stop a simulator that runs in the background, with its devices. Raises SIM-018 for any other."""
    if not running.in_background:
        raise NOT_RUNNING(
            f"{running.name} (pid {running.pid}) does not run in the background",
            expected="one that was started with --detach",
            action="End it where it was started: Ctrl-C in its terminal, or the run that it belongs to.",
        )
    offspring = descendants_of(running.pid)
    os.kill(running.pid, signal.SIGTERM)
    deadline_s = time.monotonic() + STOP_LIMIT_S
    while running.is_alive:
        if time.monotonic() > deadline_s:
            os.kill(running.pid, signal.SIGKILL)
            kill_all(offspring)
            break
        time.sleep(POLL_S)  # nobody but its parent can wait for a process
    running.log.unlink(missing_ok=True)
