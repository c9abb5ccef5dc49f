"""Faults of devices: what a doubt that they cast says."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from procedures.engine.device_faults import DeviceFaults
from procedures.workcell.arms import Halt
from ronna_hw.devices.lifecycle import LastKnown, Lifecycle
from ronna_hw.errors import LimitError
from ronna_hw.roles import ASSISTANT, MASTER

FROZEN = "the assistant has gone to fault: its telegrams stopped"


class Stopped(LimitError):
    """A stop, for these tests."""

    code = "TST-001"


def doubts_after(halt: Halt | None) -> list[str]:
    """Return what is said to have cast doubt on the bases after a fault of the arm."""
    lines: list[str] = []
    order = SimpleNamespace(localizations=(), checks_of_tool=(), relations_of_arms=("base_to_base",))
    case = SimpleNamespace(trusts=lambda _key: True, doubt=lambda _key, _fault: None)
    known = LastKnown[object](Lifecycle.FAULT, Stopped("a stop was requested"), None)
    master = SimpleNamespace(role=MASTER)
    devices = {"arm": SimpleNamespace(observe=lambda: known)}
    clock = SimpleNamespace(now_s=lambda: 12.0)
    cell = SimpleNamespace(
        devices=devices, halt=halt, master=master, clock=clock, arm_of_device=lambda _name: master
    )
    faults = DeviceFaults(
        cast("Any", SimpleNamespace(order=order, case=case)),
        cast("Any", cell),
        cast("Any", SimpleNamespace(write=lambda _entry, _at_s, **more: lines.append(more["fault"]))),
    )
    faults.doubt_results()
    return lines


@pytest.mark.parametrize(
    ("halt", "says"),
    [
        (Halt(ASSISTANT, FROZEN, None), f"a stop was requested, since {FROZEN} (theatre time 12 s)"),
        (Halt(MASTER, "the master has gone to fault", None), "a stop was requested (theatre time 12 s)"),
        (None, "a stop was requested (theatre time 12 s)"),
    ],
)
def test_a_doubt_names_the_arm_for_which_the_other_was_stopped(halt: Halt | None, says: str) -> None:
    assert doubts_after(halt) == [f"TST-001: {says}"]
