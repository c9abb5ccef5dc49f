"""Fixtures of the system tests: commands run as a user runs them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from user_commands import Commands


@pytest.fixture
def commands() -> Iterator[Commands]:
    """Commands of one test; the test fails when any process outlives it."""
    started = Commands()
    try:
        yield started
        assert started.await_no_survivors() == []
    finally:
        started.end_all()


@pytest.fixture(scope="session")
def shared_commands() -> Commands:
    """Commands for results that several tests look at."""
    return Commands()
