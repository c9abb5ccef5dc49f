"""Functions shared by all device processes: open the world, print READY, end with the parent."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import FrameType

from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.errors import EXIT_FAILED
from ronna_hw.host.child_process import descendants_of, kill_all
from ronna_hw.host.process import Parent, resume_garbage_collection
from ronna_hw.near_names import did_you_mean
from sim.errors import BAD_SCENE
from sim.world.background import IN_BACKGROUND, DaemonState, hand_over, leave_output
from sim.world.control_port import ControlledRoom, ControlPort
from sim.world.faults import read_faults
from sim.world.head_surface.skin_shift import SkinShift
from sim.world.options import ArmRole, Carrier
from sim.world.running import register
from sim.world.scene.arm_design import DESIGNS
from sim.world.scene.assistant import add_assistant
from sim.world.scene.model import ArmResidual, Scene, read_scene
from sim.world.scene.named_scenes import SCENES, add_patient_frame, draw_scene
from sim.world.world import World

PARENT_GONE = "stopping: the parent process has ended\n"
END_LIMIT_S = 1.5  # then the process is killed, in case it hangs in a system call or waits for a hung child
PARENT_CHECK_S = 0.25  # a device process must end within 2 s of its parent's death


def announce(
    device: str, endpoint: str | None = None, control: str | None = None, run: str = "", **more: object
) -> None:
    """Print the line `READY {json}`, after which clients may connect; it is registered as that of `run`."""
    resume_garbage_collection()
    content: dict[str, object] = {"device": device}
    if endpoint is not None:
        content["endpoint"] = endpoint
    if control is not None:
        content["control"] = control
    content |= more
    alone = _has_control_port(content)  # else it is a device of a theatre
    if alone:
        if IN_BACKGROUND:
            hand_over()
        register(content, in_background=IN_BACKGROUND, run=run)
    print("READY " + json.dumps(content), flush=True)  # noqa: T201 - this line is the contract
    if alone and IN_BACKGROUND:
        leave_output()


def _has_control_port(content: Mapping[str, object]) -> bool:
    endpoints = content.get("endpoints")
    return "control" in content or (isinstance(endpoints, Mapping) and "control" in endpoints)


def end_with_parent(end: Callable[[], None]) -> None:
    """Call `end` on SIGTERM or SIGINT, or when the parent process has ended before a hand-over.

    `end` must make the process leave its main loop; if it still runs 1.5 s later, it is killed with its
    descendants.
    """

    def leave() -> None:
        end()
        timer = threading.Timer(END_LIMIT_S, end_hard)
        timer.daemon = True
        timer.start()

    def end_hard() -> None:
        kill_all(descendants_of(os.getpid()))
        os._exit(0)

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        leave()

    def watch() -> None:
        while DaemonState.done or not Parent.noted.is_gone:
            time.sleep(PARENT_CHECK_S)
        with contextlib.suppress(OSError):  # there may be no reader left
            sys.stderr.write(PARENT_GONE)
            sys.stderr.flush()
        leave()

    threading.excepthook = _end_with_thread
    signal.signal(signal.SIGTERM, on_signal)
    signal.signal(signal.SIGINT, on_signal)
    threading.Thread(target=watch, name="parent watch", daemon=True).start()


def _end_with_thread(failure: threading.ExceptHookArgs) -> None:
    """Report a thread's failure and end the process, which would otherwise stop responding unnoticed."""
    traceback.print_exception(failure.exc_type, failure.exc_value, failure.exc_traceback)
    sys.stderr.write(f"{failure.thread.name if failure.thread else 'a thread'} failed: {failure.exc_value}\n")
    sys.stderr.flush()
    os._exit(EXIT_FAILED)


def open_world(
    world: str | None,
    scene: str,
    faults: Path | None = None,
    devices: Sequence[str] | None = None,
    *,
    paced: bool = True,
    variant: str = "",
    role: ArmRole = ArmRole.MASTER,
) -> World:
    """Open the theatre's world, or create one for a standalone simulator, on the host's clock if `paced`.

    `scene` is a built-in name, drawn with an arm of this variant, or a file; `devices` are those simulated in
    a world of its own. In a theatre, `role` is that of the arm that this process simulates.
    """
    if world is not None:
        return World.open(world, role)
    truth = _draw_alone(scene, variant) if variant and scene in SCENES else load_scene(scene)
    script = read_faults(faults, truth, devices) if faults else ""
    own = World.create(truth, paced=paced)
    if script:
        own.set_fault_script(script)
    return own


def _draw_alone(scene: str, variant: str) -> Scene:
    """Draw a scene with an arm; one that no scene is drawn with replaces the arm that it is a size of."""
    choice = DESIGNS[variant].choice
    if choice is not None:
        return load_scene(scene, arm=choice)
    drawn = load_scene(scene, arm=ArmChoice.UR5E)
    return drawn.model_copy(update={"arm": drawn.arm.model_copy(update={"variant": variant})})


def open_own_control_port(
    world: str | None, own: World, devices: Sequence[str], loaded: Callable[[], Sequence[str]] | None = None
) -> str | None:
    """Open a standalone simulator's control port, or return None in a theatre, which has its own."""
    return None if world is not None else ControlPort(ControlledRoom(own, None, devices, loaded)).endpoint


def load_scene(
    scene: str,
    *,
    seed: int = 0,
    markers: int | None = None,
    targets: int | None = None,
    fiducials: Carrier = Carrier.FREE,
    arm: ArmChoice = ArmChoice.KR6,
    calibrated: bool = False,
    first_day: bool = False,
    target_balls: bool = False,
    dual: bool = False,
    assistant_arm: ArmChoice = ArmChoice.KR6,
    drill: bool = False,
) -> Scene:
    """Draw a named scene, or read a scene file; raises SIM-001.

    `calibrated`: the arm has a calibration record. `first_day`: frame and tip have no valid one.
    `target_balls`: a ball at each target; a named scene is then a rigid phantom. `dual`: a second arm, unless
    the scene has one; both arms are calibrated, as two arms must be. `drill`: the theatre's assistant drills.
    """
    if scene in SCENES:
        drawn = draw_scene(scene, seed=seed, markers=markers, targets=targets, fiducials=fiducials, arm=arm)
    elif fiducials is not Carrier.FREE:
        raise BAD_SCENE("a scene file defines how its spheres are fixed: omit --fiducials")
    elif arm is not ArmChoice.KR6:
        raise BAD_SCENE("a scene file defines its arm: omit --arm")
    elif not Path(scene).exists() and (near := did_you_mean(scene, SCENES)):
        raise BAD_SCENE(
            f"there is no scene {scene!r}", expected=f"{', '.join(SCENES)} or a file", action=near
        )
    else:
        drawn = read_scene(Path(scene))
    if target_balls:
        head = drawn.head.model_copy(update={"target_balls": True})
        if scene in SCENES:
            head = head.model_copy(update={"skin_shift": SkinShift()})
        drawn = drawn.model_copy(update={"head": head})
    if dual and not drawn.holders:
        # Two arms often hide a sphere of three; the frame on the clamp is then watched in their place.
        drawn = add_assistant(add_patient_frame(drawn), assistant_arm)
    if drill and drawn.assistant is not None:
        drawn = drawn.model_copy(update={"assistant": drawn.assistant.model_copy(update={"drills": True})})
    error = drawn.calibration_error
    # Looks at the skin from many sides need a calibrated arm, as two arms do.
    if (calibrated or dual or drawn.projector is not None) and error.arm is None:
        error = error.model_copy(update={"arm": ArmResidual()})
    if first_day:
        error = error.model_copy(update={"first_day": True})
    return drawn.model_copy(update={"calibration_error": error})


def fail(message: str, exit_code: int) -> None:
    """Report why a device process cannot start, then exit."""
    sys.stderr.write(message + "\n")
    raise SystemExit(exit_code)
