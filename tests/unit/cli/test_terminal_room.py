"""Who sits at the terminal is told what to mount, and in a simulated room how."""

from __future__ import annotations

import pytest

from procedures.cli.case.operators import TerminalRoom


@pytest.mark.parametrize("simulated", [True, False])
def test_only_in_a_simulated_room_a_command_mounts_the_tool(
    simulated: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    TerminalRoom(simulated=simulated).change_tool(2, "the surgical guide")
    told = capsys.readouterr().err
    assert told.startswith("Mount the surgical guide (tool 2).\n")
    assert ("ronna-sim mount 2 --control" in told) == simulated
