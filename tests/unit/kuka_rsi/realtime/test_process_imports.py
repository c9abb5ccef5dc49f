"""The real-time process imports only what it needs, from its start through a motion to its end."""

from __future__ import annotations

import os
from collections.abc import Callable

import pytest

from drivers.kuka_rsi.arm import KukaRsiArm

HEAVY = {"numpy", "scipy", "pydantic", "cv2", "structlog", "pinocchio", "pydicom", "typer"}


def test_a_running_link_imports_no_heavy_package(
    make_arm: Callable[..., KukaRsiArm], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPROFILEIMPORTTIME", "1")  # the process lists each import on standard error
    arm = make_arm()
    arm.connect()
    arm.configure()
    arm.activate()
    start = arm.read_state().joints_rad
    arm.move_joints((start[0] + 0.01, *start[1:]))
    stream = arm._connections.link._process.stderr
    assert stream is not None
    with os.fdopen(os.dup(stream.fileno()), encoding="utf-8") as messages:
        arm.close()
        imported = {line.rsplit("|", 1)[-1].strip() for line in messages if line.startswith("import time:")}
    assert "drivers.kuka_rsi.realtime.loop" in imported
    assert not HEAVY & {name.split(".")[0] for name in imported}
