"""A simulated theatre starts before what the steps need is imported, and ends however its run does."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from procedures.runs import simulated_theatre
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.simulated_theatre import SimulatedRoom, SimulatedTheatre
from ronna_hw.errors import RonnaError
from sim.world.control_port import ControlledRoom, ControlPort
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World


def test_the_theatre_ends_when_its_patient_cannot_be_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended: list[str] = []

    class Theatre:
        def __init__(self, *_arguments: str, **_more: object) -> None: ...

        def end(self) -> None:
            ended.append("theatre")

    def no_process_left(*_: object) -> None:
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(simulated_theatre, "TheatreProcess", Theatre)
    monkeypatch.setattr(simulated_theatre, "_start_phantom", no_process_left)
    with pytest.raises(OSError, match="Resource temporarily unavailable"):
        SimulatedTheatre(RunRequest(procedure=CaseProcedure()), tmp_path, tmp_path / "phantom")
    assert ended == ["theatre"]


def test_the_simulated_wristband_is_that_of_the_theatres_patient() -> None:
    port = ControlPort(ControlledRoom(World.create(draw_scene("mini", seed=7), paced=False), None))
    assert SimulatedRoom(port.endpoint).read_wristband() == "mini-7"
    port.close()


@pytest.mark.parametrize(
    ("problem", "named"), [(None, True), (RonnaError("a failed step"), True), (KeyboardInterrupt(), False)]
)
def test_a_fault_that_came_too_late_is_named_when_the_run_ends(
    problem: BaseException | None, named: bool
) -> None:
    world = World.create(draw_scene("mini"), paced=False)
    world.set_fault_script("at 0 s: room wrong tool 1")
    port = ControlPort(ControlledRoom(world, None))
    told: list[str] = []
    at_exit = SimulatedRoom(port.endpoint).tell_missed_faults(told.append)
    at_exit(None, problem, None)
    port.close()
    at_exit(None, problem, None)  # the theatre has ended: that is no error here
    assert (
        told
        == [
            "warning: room wrong tool 1 had no effect: it began before the first step, and no tool was "
            "mounted after that"
        ]
        * named
    )


SCRIPT = """
import sys
from procedures.runs.simulated_theatre import SimulatedTheatre

def started(*_arguments, **_options):
    heavy = {"numpy", "scipy", "cv2", "pydicom", "matplotlib", "procedures.engine.engine"}
    print(*heavy & set(sys.modules))
    raise SystemExit(0)

SimulatedTheatre.__init__ = started
from procedures.cli.procedure import main
main()
"""


def test_a_simulated_theatre_starts_before_anything_heavy_is_imported(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SCRIPT, "run", "--sim", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()) == (0, []), done.stderr
