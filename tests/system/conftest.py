"""Fixtures of the system tests: commands run as a user runs them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from faulty_cameras import Cameras
from simulated_case import SimulatedCase
from user_commands import Commands

from ronna_hw.host.child_process import ChildProcess, command


@pytest.fixture(scope="session")
def shared_commands() -> Commands:
    """Commands for results that several tests look at."""
    return Commands()


@pytest.fixture
def case(commands: Commands, tmp_path: Path) -> SimulatedCase:
    """A simulated case of this test."""
    return SimulatedCase(commands, tmp_path)


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
