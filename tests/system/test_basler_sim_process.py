"""The command `ronna-sim basler`: what it announces, what it refuses, when it ends, and its lock-step."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time

import numpy as np
from faulty_cameras import LIMIT_S, Cameras
from user_commands import in_this_process

from ronna_hw.host.child_process import STOP_TIMEOUT_S, ChildProcess, command
from ronna_hw.wire.gige_vision import GVCP_PORT
from sim.cli import app


def test_ready_names_the_endpoints_of_both_cameras() -> None:
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler")) as cameras:
        assert cameras.ready["device"] == "basler"
        assert set(cameras.ready["endpoints"]) == {"left", "right"}
        assert all(address.startswith("127.77.") for address in Cameras(cameras).addresses)


def test_it_ends_in_time_while_it_streams_and_the_same_trigger_gives_the_same_image(cameras: Cameras) -> None:
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler")) as child:
        others = Cameras(child)
        assert set(others.addresses).isdisjoint(cameras.addresses)
        pairs = [each.streaming() for each in (cameras, others)]
        first, second = (pair.grab_pair(LIMIT_S).left for pair in pairs)
        assert first is not None
        assert second is not None
        assert np.array_equal(first.pixels, second.pixels)
        pairs[1].deactivate(LIMIT_S)
        pairs[1]._pair[0].features.choose("TriggerMode", "Off")
        pairs[1].activate(LIMIT_S)
        begun = time.monotonic()
        child.process.terminate()
        assert child.process.wait(LIMIT_S) == 0
        assert time.monotonic() - begun < STOP_TIMEOUT_S
        pairs[1].close()


def test_it_ends_with_its_parent() -> None:
    line = command("sim.cli", "basler")
    script = f"import subprocess, time; subprocess.Popen({line!r}); time.sleep(60)"
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    with parent:
        assert parent.stdout is not None
        ready = json.loads(parent.stdout.readline().removeprefix("READY "))
        address = ready["endpoints"]["left"].removeprefix("gev://")
        parent.kill()
        begun = time.monotonic()
        # Its address is free again as soon as it has ended.
        while True:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                try:
                    probe.bind((address, GVCP_PORT))
                    break
                except OSError:
                    assert time.monotonic() - begun < LIMIT_S
            time.sleep(0.05)
    assert time.monotonic() - begun < STOP_TIMEOUT_S


def test_given_addresses_are_used_and_taken_ones_refused() -> None:
    given = ("--address", "127.76.5.1", "--address", "127.76.5.2")
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler", *given)) as cameras:
        assert Cameras(cameras).addresses == ("127.76.5.1", "127.76.5.2")
        second = subprocess.run(command("sim.cli", "basler", *given), capture_output=True, text=True)
        assert second.returncode == 4
        assert "SIM-004" in second.stderr
        assert "127.76.5.1 is in use" in second.stderr


def test_an_unknown_scene_is_told() -> None:
    ended = in_this_process(app, "basler", "--scene", "nowhere.toml")
    assert ended.returncode == 2
    assert "SIM-001" in ended.stderr
