"""Fixtures of the system tests: commands run as a user runs them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from faulty_cameras import Cameras
from user_commands import Commands

from ronna_hw.host.child_process import ChildProcess, command


@pytest.fixture(scope="session")
def shared_commands() -> Commands:
    """Commands for results that several tests look at."""
    return Commands()


@pytest.fixture(scope="session")
def running_cameras() -> Iterator[Cameras]:
    """The simulated cameras, in a process for all tests of a worker."""
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler")) as child:
        yield Cameras(child)


@pytest.fixture
def cameras(running_cameras: Cameras) -> Iterator[Cameras]:
    """The simulated cameras, without faults and under nobody's control."""
    yield running_cameras
    running_cameras.close()
