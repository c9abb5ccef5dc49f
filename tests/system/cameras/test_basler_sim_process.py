"""The command `ronna-sim basler`: what it announces, what it refuses, when it ends, and its lock-step."""

from __future__ import annotations

import subprocess

import numpy as np
from faulty_cameras import LIMIT_S, Cameras
from parent_death import ends_with_its_parent
from waiting import STALL_OF_THE_COMPUTER_S

from ronna_hw.host.child_process import STOP_TIMEOUT_S, ChildProcess, command


def test_ready_names_the_endpoints_of_both_cameras() -> None:
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler")) as cameras:
        assert cameras.ready["device"] == "basler"
        assert set(cameras.ready["endpoints"]) == {"left", "right"}
        assert all(address.startswith("127.77.") for address in Cameras(cameras).addresses)


def test_the_simulator_ends_in_time_while_streaming_and_the_same_trigger_gives_the_same_image(
    cameras: Cameras,
) -> None:
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
        child.process.terminate()
        assert child.process.wait(STOP_TIMEOUT_S + STALL_OF_THE_COMPUTER_S) == 0
        pairs[1].close()


def test_the_simulator_ends_with_its_parent() -> None:
    assert ends_with_its_parent(command("sim.cli", "basler"))


def test_given_addresses_are_used_and_addresses_in_use_refused() -> None:
    given = ("--address", "127.76.5.1", "--address", "127.76.5.2")
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler", *given)) as cameras:
        assert Cameras(cameras).addresses == ("127.76.5.1", "127.76.5.2")
        second = subprocess.run(command("sim.cli", "basler", *given), capture_output=True, text=True)
        assert second.returncode == 4
        assert "SIM-004" in second.stderr
        assert "127.76.5.1: in use" in second.stderr
