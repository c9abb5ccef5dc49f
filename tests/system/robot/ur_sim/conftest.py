"""Universal Robots controllers as processes of their own, one for the tests of a module."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from ur_clients import UrCell


@pytest.fixture(scope="module")
def cell() -> Iterator[UrCell]:
    """A CB3 controller in real time, with small buffers."""
    with ExitStack() as stack:
        yield UrCell(stack, "--model", "ur5", "--set", "send_buffer_bytes=4096", number=1)


@pytest.fixture(scope="module")
def lock_step_cell() -> Iterator[UrCell]:
    """An e-Series controller in lock-step."""
    with ExitStack() as stack:
        yield UrCell(stack, "--lock-step", "--set", "protective_stop_lock_s=0.1", number=2)
