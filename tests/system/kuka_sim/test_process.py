"""The robot controller as a process: signals, its parent's death, a port in use."""

from __future__ import annotations

from kuka_clients import FREE
from parent_death import ends_with_its_parent

from ronna_hw.host.child_process import command


def test_it_ends_within_two_seconds_of_its_parents_death() -> None:
    assert ends_with_its_parent(
        command("sim.cli", "kuka", "--eki", FREE, "--eki-project", FREE, "--scene", "mini")
    )
