"""The robot controller as a process: it ends when its parent dies."""

from __future__ import annotations

from kuka_clients import FREE
from parent_death import ends_with_its_parent

from ronna_hw.host.child_process import command


def test_the_controller_ends_within_two_seconds_of_the_death_of_its_parent() -> None:
    assert ends_with_its_parent(
        command("sim.cli", "kuka", "--eki", FREE, "--eki-project", FREE, "--scene", "mini")
    )
