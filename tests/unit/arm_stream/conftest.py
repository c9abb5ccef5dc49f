"""Mailbox of a real-time process."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from ronna_hw.arm_stream.mailbox import Mailbox


@pytest.fixture
def memory() -> Iterator[int]:
    fd = os.memfd_create("test")
    Mailbox.initialise(fd)
    yield fd
    os.close(fd)


@pytest.fixture
def mailbox(memory: int) -> Iterator[Mailbox]:
    box = Mailbox(memory)
    yield box
    box.close()
