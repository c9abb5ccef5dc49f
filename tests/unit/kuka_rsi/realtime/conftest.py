"""Receive loop of the driver with an open session."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from rsi_loop import InProcessLink


@pytest.fixture
def link() -> Iterator[InProcessLink]:
    made = InProcessLink()
    made.open()
    yield made
    made.close()
