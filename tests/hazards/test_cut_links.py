"""Hazard 4: whichever link fails in whichever step, the case is held and names the device."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NoReturn

import pytest
from clinical_case import FIRST, ClinicalCell
from prepared_results import checked_paths, up_to_correspondence
from recording_cell import RecordingDevice
from user_commands import Commands

from procedures.engine.engine import Engine
from procedures.engine.machine import HELD
from procedures.journal.errors import StepRefused
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.steps.clinical import (
    at_target,
    confirmation,
    positioning,
    registration,
    relocalization,
    retreat,
    tool_change,
    tool_check,
)
from procedures.workcell import MountedTool
from ronna_hw.devices.lifecycle import LastKnown, Lifecycle
from ronna_hw.errors import EXIT_LINK_LOST, LinkTimeout

WORKING = (
    relocalization.STEP, registration.STEP, tool_change.STEP, tool_check.STEP,
    positioning.STEP, at_target.STEP, retreat.STEP, confirmation.STEP,
)  # fmt: skip
WITH_GUIDE = WORKING[2:]  # the stereo head hangs on its rest
CUTS = [
    pytest.param(step.name, role, marks=pytest.mark.slow if role == "stereo" and step in WITH_GUIDE else ())
    for step in WORKING
    for role in ("arm", "stereo", "tracker")
]
USES = ("read_state", "read_tool_identity", "move", "activate", "set_areas", "grab_pair")
NO_ANSWER = LinkTimeout("the link is dead")


class LinkCut:
    """Cuts the link of one device when a step is announced: every call fails, the fault is latched."""

    def __init__(self, cell: ClinicalCell, role: str, step: str) -> None:
        self._device: RecordingDevice = {"arm": cell.arm, "stereo": cell.stereo, "tracker": cell.tracker}[
            role
        ]
        self._cell, self._role, self._step = cell, role, step
        self._announce = cell.room.announce
        self.moved_before: int | None = None
        cell.room.announce = self.announce  # type: ignore[method-assign]

    def announce(self, step: str) -> None:
        self._announce(step)
        if step == self._step:
            self.cut()

    def cut(self) -> None:
        device = self._device
        self.moved_before = len(self._cell.arm.motions)
        device.state = Lifecycle.FAULT
        device.observe = lambda: LastKnown(Lifecycle.FAULT, NO_ANSWER, None)  # type: ignore[method-assign]
        for name in USES:
            if hasattr(device, name):
                setattr(device, name, self._dead)
        if self._role == "stereo":
            self._cell.workcell.look = self._dead  # type: ignore[method-assign]

    def _dead(self, *_: object, **__: object) -> NoReturn:
        raise NO_ANSWER


def prepared(cell: ClinicalCell) -> Engine:
    cell.carrying(MountedTool.GUIDE)
    paths = checked_paths(cell)  # its targets are the guide's
    cell.carrying(MountedTool.STEREO_HEAD)
    localizations = checked_paths(cell).localizations
    return cell.begin(
        *up_to_correspondence(cell), paths.model_copy(update={"localizations": localizations}), *WORKING
    )


@pytest.mark.hazard(4)
@pytest.mark.parametrize(("step", "role"), CUTS)
def test_a_link_cut_during_a_step_holds_the_case(cell: ClinicalCell, step: str, role: str) -> None:
    engine = prepared(cell)
    key = next(key for key in engine.order.sequence if key.name == step and key.trajectory in (None, FIRST))
    link = LinkCut(cell, role, str(key))
    with pytest.raises((LinkTimeout, StepRefused), match=r"the link is dead"):
        engine.run_to()
    assert link.moved_before is not None
    assert not engine.machine.ended
    assert engine.faults.now.keys() == {role}
    waiting = engine.upcoming
    assert waiting is not None
    assert any(f"the {role} is in fault" in reason for reason in engine.why_refused(waiting))
    if not engine.case.stands(key):  # the step itself met the dead link
        assert engine.machine.state == HELD
    if role == "arm":
        assert len(cell.arm.motions) == link.moved_before


@pytest.mark.hazard(4)
@pytest.mark.slow
@pytest.mark.timeout(180)
@pytest.mark.parametrize(
    ("step", "fault"),
    [
        ("global_localization", "tracker power off"),
        ("relocalization", "camera unplug left"),
        ("relocalization", "robot network cut"),
        ("positioning", "robot eki cut"),
    ],
)
def test_a_link_cut_during_a_whole_case_ends_it_with_the_exit_code_of_a_lost_link(
    commands: Commands, tmp_path: Path, step: str, fault: str
) -> None:
    script = tmp_path / "faults.txt"
    script.write_text(f"when step == {step}: {fault}\n")
    options = ("--scene", "mini", "--seed", "3", "--faults", str(script), "--out", str(tmp_path / "runs"))
    done = commands.run("ronna-procedure", "run", "--sim", "--json", *options, timeout_s=150)
    assert done.returncode == EXIT_LINK_LOST, done.stderr
    ended = json.loads(done.stdout)
    folder = tmp_path / "runs" / ended["run"]
    lines = list(read_journal(folder / JOURNAL_FILE))
    (failed,) = [line for line in lines if line["entry"] == "failed"]
    assert str(failed["step"]).partition(":")[0] == step
    after = [line["entry"] for line in lines[lines.index(failed) + 1 :]]
    assert after == ["closed"]
    assert ended["error"]["code"] in Path(ended["report"]).read_text()
