"""`ronna-sim theatre`, its staff commands, `ronna-sim scene` and `ronna-sim verify`."""

from __future__ import annotations

import math
import unicodedata
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.command_line.errors import PATH_PROBLEM, UsageMistake
from ronna_hw.command_line.options import require_folder
from ronna_hw.command_line.terminal import JsonOption, print_json, print_table, say, tell
from ronna_hw.control_port import VARIABLE, ask_control_port
from ronna_hw.wire.polaris import PolarisModel
from ronna_hw.wire.room_tasks import OnStand
from sim.world import options
from sim.world.background import start_in_background
from sim.world.options import Carrier, CycleMs

if TYPE_CHECKING:
    import threading

    from sim.theatre.launch import LaunchedTheatre

# By the environment: on the command line every user here could read the token.
_CONTROL_OPTION = typer.Option(envvar=VARIABLE, help="Control port, from the READY line or ronna-sim env.")
ControlOption = Annotated[str, _CONTROL_OPTION]
ControlIfGiven = Annotated[str | None, _CONTROL_OPTION]
ArmOption = Annotated[ArmChoice, typer.Option(case_sensitive=False, help="Arm of a named scene.")]
FiducialsOption = Annotated[
    Carrier,
    typer.Option(
        help="Spheres on screws or on the x-shaped frame; or the skin of a head with a face, without spheres "
        "(surface) or with 1 to 3 (mixed)."
    ),
]


class Wheeled(StrEnum):
    """Objects that staff can move."""

    CART = "cart"


class TrackerService(StrEnum):
    """Ways to reach the tracker of a theatre."""

    POLARIS = "polaris"
    PLUS = "plus"


class Speed(StrEnum):
    """Pace of theatre time."""

    MAX = "max"
    REAL = "1"


def theatre(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="Folder for theatre.toml and its files.")] = Path("theatre"),
    scene: options.SceneOption = "default",
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything drawn at random.")] = 0,
    markers: options.MarkersOption = None,
    targets: options.TargetsOption = None,
    fiducials: FiducialsOption = Carrier.FREE,
    arm: ArmOption = ArmChoice.KR6,
    calibrated: Annotated[
        bool,
        typer.Option(
            "--calibrated",
            help="Include a calibration record of the arm, and one of the stereo head made with it.",
        ),
    ] = False,
    first_day: Annotated[
        bool,
        typer.Option("--first-day", help="Frame and guide as designed: their records must be made first."),
    ] = False,
    calibration: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FOLDER",
            help="Use the records written by a calibration command instead of its own; repeatable.",
        ),
    ] = None,
    target_balls: Annotated[
        bool, typer.Option("--target-balls", help="Put a ball at each target, as on a phantom.")
    ] = False,
    dual: Annotated[
        bool,
        typer.Option(
            "--dual",
            help="Add a second arm, the assistant, on a cart of its own, and records of both arms.",
        ),
    ] = False,
    assistant_arm: Annotated[
        ArmChoice, typer.Option(case_sensitive=False, help="With --dual: the model of the assistant.")
    ] = ArmChoice.KR6,
    drill: Annotated[
        bool, typer.Option("--drill", help="With --dual: the assistant drills the skull, not a hand.")
    ] = False,
    tracker: Annotated[
        TrackerService,
        typer.Option(
            help="polaris: the unit itself. plus: its tools alone, served by OpenIGTLink as PlusServer does."
        ),
    ] = TrackerService.POLARIS,
    speed: Annotated[Speed, typer.Option(help="max for as fast as possible, 1 for real time.")] = Speed.MAX,
    cycle_ms: Annotated[
        CycleMs | None, typer.Option(help="Sensor cycle of the robot in ms [default: the context's].")
    ] = None,
    faults: options.FaultsOption = None,
    continued: Annotated[
        bool,
        typer.Option(
            "--continue",
            help="Continue with the world left in that folder; what faults moved or bent stays that way.",
        ),
    ] = False,
    parameter: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="DEVICE.NAME=VALUE",
            help="Change a parameter of robot, assistant or tracker, such as robot.lag_s=0.03; repeatable.",
        ),
    ] = None,
    tell_truth: Annotated[
        bool,
        typer.Option("--tell-truth", help="Tell the truth at the control port, for a study; no run does."),
    ] = False,
    run: Annotated[str, typer.Option(hidden=True, help="Run that it belongs to, and is listed as.")] = "",
    detach: options.DetachOption = False,
) -> None:
    """Simulate a whole theatre and write its theatre.toml, until terminated."""
    import threading

    from ronna_hw.errors import EXIT_FAILED
    from sim.theatre.arm_controllers import check_cycle
    from sim.theatre.launch import PLUS_ENDPOINT, LaunchedTheatre, parameters_by_device, read_calibrations
    from sim.world.faults import read_faults
    from sim.world.process import end_with_parent, fail, load_scene
    from sim.world.saved_world import lock_folder, read_saved_world
    from sim.world.truth import SCENE_FILE

    if drill and not (dual or continued):
        raise UsageMistake(
            "--drill requires --dual", expected="a theatre of two arms", action="Add --dual, or omit --drill."
        )
    if not dual and _is_typed(context, "assistant_arm"):
        raise UsageMistake(
            f"--assistant-arm {assistant_arm} requires --dual",
            expected="a theatre with two arms",
            action="Add --dual, or omit --assistant-arm.",
        )
    require_folder(out)
    _require_plain_name(out)
    if detach and start_in_background("theatre"):
        return
    saved_scene = out / SCENE_FILE  # a scene file may have been changed since
    if continued:
        _require_left_world(out)
        _require_same_world(context, out)
    scene_source = str(saved_scene) if continued else scene
    truth = load_scene(
        scene_source,
        seed=seed,
        markers=markers,
        targets=targets,
        fiducials=Carrier.FREE if continued else fiducials,
        arm=ArmChoice.KR6 if continued else arm,
        calibrated=calibrated,
        first_day=first_day,
        target_balls=target_balls,
        dual=dual,
        assistant_arm=assistant_arm,
        drill=drill,
    )
    records = read_calibrations(calibration or ())
    script = read_faults(faults, truth) if faults else ""
    chosen_ms = None if cycle_ms is None else int(cycle_ms.value)
    check_cycle(truth, chosen_ms)
    parameters = parameters_by_device(parameter or (), truth)
    ended = threading.Event()
    with lock_folder(out):
        running = LaunchedTheatre(
            truth,
            out,
            paced=speed is Speed.REAL,
            tracker_endpoint=PLUS_ENDPOINT if tracker is TrackerService.PLUS else None,
            cycle_ms=chosen_ms,
            faults=script,
            parameters=parameters,
            saved=read_saved_world(out) if continued else None,
            records=records,
            on_forked=lambda: end_with_parent(ended.set),
            tells_truth=tell_truth,
        )
        reasons = _serve(running, ended, run)
    if reasons:
        fail(reasons[0], EXIT_FAILED)


def _require_plain_name(folder: Path) -> None:
    """Raise CLI-005 if a control character in the folder's path would act on every terminal that lists it."""
    path = str(folder.resolve())
    if any(unicodedata.category(character) == "Cc" for character in path):
        raise PATH_PROBLEM(
            f"--out: {path!r} has a control character", expected="a path of letters, digits and signs"
        )


def _require_left_world(folder: Path) -> None:
    """Raise SIM-012 unless a theatre has left its world in the folder."""
    from sim.errors import BAD_SAVED_WORLD
    from sim.theatre.launch import THEATRE_FILE
    from sim.world.saved_world import WORLD_FILE
    from sim.world.truth import SCENE_FILE

    missing = [name for name in (SCENE_FILE, WORLD_FILE, THEATRE_FILE) if not (folder / name).exists()]
    if missing:
        raise BAD_SAVED_WORLD(
            f"--continue: no theatre left its world in {folder}: {', '.join(missing)} missing",
            expected="a folder in which a theatre has run",
        )


def _require_same_world(context: typer.Context, folder: Path) -> None:
    """Raise CLI-001 if an option contradicts the world being continued."""
    from sim.world.scene.arm_design import DESIGNS
    from sim.world.scene.model import read_scene
    from sim.world.scene.named_scenes import SCENES
    from sim.world.truth import SCENE_FILE

    if context.params["scene"] not in SCENES:  # a file, which may have been changed, and has its own seed
        return
    saved = read_scene(folder / SCENE_FILE)
    owns = {
        "scene": saved.name,
        "seed": saved.seed,
        "markers": len(saved.head.fiducials),
        "targets": len(saved.head.targets),
        "arm": DESIGNS[saved.arm.variant].choice or saved.arm.variant,
    }
    for option, own in owns.items():
        given_value = context.params[option]
        if _is_typed(context, option) and given_value != own:
            raise UsageMistake(
                f"--continue: the {option} of the world left in {folder / SCENE_FILE} cannot be changed",
                expected=f"{own}",
                got=f"{given_value}",
                action=f"Omit --{option} to continue it, or omit --continue for a new world.",
            )


def _is_typed(context: typer.Context, option: str) -> bool:
    source = context.get_parameter_source(option)
    return source is not None and source.name == "COMMANDLINE"


def _serve(running: LaunchedTheatre, ended: threading.Event, run: str) -> list[str]:
    """Serve until `ended` is set, and return the reason if a device ended unprompted."""
    from sim.world.process import announce

    reasons: list[str] = []
    try:

        def report_end(reason: str) -> None:
            if not ended.is_set():
                reasons.append(reason)
                ended.set()

        running.watch(report_end)
        announce(
            "theatre",
            run=run,
            endpoints={
                **running.endpoints,
                "control": running.control,
                "clock": running.world.clock_endpoint,
            },
            file=str(running.file.resolve()),
        )
        ended.wait()
    finally:
        running.close()
    return reasons


def mount(
    number: Annotated[
        int,
        typer.Argument(min=0, help="Tool to mount: usually 1 the stereo head, 2 the guide; 0 removes it."),
    ],
    control: ControlOption,
) -> None:
    """Mount another tool in a running theatre, as the staff would."""
    ask_control_port(control, "mount", number=number)
    tell(f"tool {number} is mounted" if number else "no tool is mounted")


def stand(
    holds: Annotated[OnStand, typer.Argument(help="Object to put on the calibration stand.")],
    control: ControlOption,
) -> None:
    """Put ball or divot on the calibration stand of a running theatre, or remove both."""
    ask_control_port(control, "stand", holds=holds.value)
    tell(f"on the stand: {holds.value}")


def move(
    _what: Annotated[Wheeled, typer.Argument(metavar="cart", help="Object to move: the cart of an arm.")],
    by: Annotated[
        tuple[float, float, float],
        typer.Option(metavar="X Y Z", help="Way in mm, along the robot's present x, y and z."),
    ] = (0.0, 0.0, 0.0),
    turn: Annotated[
        float, typer.Option(metavar="DEG", help="Turn in deg about the robot's z axis, through its base.")
    ] = 0.0,
    number: Annotated[int, typer.Argument(help="Number of the cart, one per arm.")] = 1,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Move it even with an instrument in the guide.")
    ] = False,
    control: ControlIfGiven = None,
) -> None:
    """Wheel the cart of an arm to another place in a running theatre, as the staff would."""
    from sim.world.carts import CartDisplacement

    CartDisplacement(number, by, turn).check_size()  # JSON has no number for the values refused here
    ask_control_port(
        _require_control(control, "to move the cart"),
        "move",
        cart=number,
        by_mm=list(by),
        turn_deg=turn,
        anyway=anyway,
    )
    x, y, z = by
    tell(f"cart {number} was moved by {x:g} {y:g} {z:g} mm and turned by {turn:g} deg")


def _require_control(control: str | None, purpose: str) -> str:
    """Return the given control port, or raise CLI-001 saying where to find it."""
    if control is None:
        raise UsageMistake(
            f"no control port {purpose}",
            expected="--control 'tcp://127.0.0.1:PORT?token=...' or the variable RONNA_CONTROL",
            action='Run eval "$(ronna-sim env CELL)", as ronna-sim list names it; ronna-procedure run --sim '
            "and step --sim print theirs.",
        )
    return control


def work(
    task: Annotated[str, typer.Argument(help="Manual task, such as depth_stop, insert, out or gauge.")],
    control: ControlOption,
    numbers: Annotated[
        list[float] | None, typer.Argument(help="Values for the task, as in the question.")
    ] = None,
    trajectory: Annotated[str, typer.Option(help="Trajectory of the plan, for a task that needs one.")] = "",
) -> None:
    """Work with guide and instrument in a running theatre, as the staff would; prints the readings."""
    answer = ask_control_port(control, "work", task=task, trajectory=trajectory, numbers=list(numbers or ()))
    tell(f"done: {task}{f' at {trajectory}' if trajectory else ''}")
    for reading in answer.get("readings", ()):
        typer.echo(f"{reading:g}")


def fault(
    line: Annotated[
        str | None,
        typer.Argument(
            help="A fault such as 'tracker occlude marker 3 for 2 s' or 'assistant robot emergency stop', or "
            "a whole line of a fault script."
        ),
    ] = None,
    control: ControlIfGiven = None,
    clear: Annotated[bool, typer.Option("--clear", help="End this fault; without one, all.")] = False,
    check: Annotated[
        Path | None, typer.Option(help="Only read this fault script, and refuse its wrong lines.")
    ] = None,
) -> None:
    """Inject a fault into a running theatre or simulator, or clear it; without one, list all faults."""
    from sim.world.faults import FAULT_KINDS, read_faults

    if check is not None:
        read_faults(check, None)
        return
    if line is None and not clear:
        rows = [(kind.usage, "once" if kind.momentary else "lasts", kind.meaning) for kind in FAULT_KINDS]
        print_table("Faults that can be injected", ("fault", "", "effect"), rows)
        return
    control = _require_control(control, f"for the fault {line!r}" if line else "to clear faults")
    if clear:
        ask_control_port(control, "clear_faults", **({} if line is None else {"line": line}))
        say("all faults cleared" if line is None else f"cleared: {line}")
    elif line is not None:
        say(ask_control_port(control, "fault", line=line)["effect"])


def verify(
    run: Annotated[Path, typer.Argument(help="Folder of a completed run.")],
    theatre: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the theatre in which the run was made; runs made with --sim contain theirs."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare a completed run with the ground truth of its theatre."""
    from sim.theatre.verify import PARTS, require_targets, verify_run

    outcome = verify_run(run, theatre)
    if as_json:
        print_json(outcome)
    require_targets(run, outcome)
    if as_json:
        return
    print_table(
        "Error of the guide's tip against ground truth",
        ("target", "depth mm", "error mm", "lateral mm", "axial mm", "registration mm", "arm mm"),
        [
            (
                row["id"],
                f"{row['depth_mm']:.1f}",
                f"{row['application_error_mm']:.3f}",
                f"{row['lateral_mm']:.3f}",
                f"{row['axial_mm']:+.3f}",
                *(f"{math.hypot(*row['parts'][part]):.3f}" if "parts" in row else "" for part in PARTS),
            )
            for row in outcome["targets"]
        ],
    )


def scene(
    scene: options.SceneOption = "default",
    seed: Annotated[int, typer.Option(min=0, help="Seed of a named scene.")] = 0,
    markers: options.MarkersOption = None,
    targets: options.TargetsOption = None,
    fiducials: FiducialsOption = Carrier.FREE,
    arm: ArmOption = ArmChoice.KR6,
    template: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Implant the spheres with this template from `ronna-plan template`."
        ),
    ] = None,
    patient_frame: Annotated[
        bool,
        typer.Option("--patient-frame", help="Put the patient's tracked frame on the head clamp."),
    ] = False,
    tracker: Annotated[
        PolarisModel | None, typer.Option(help="Model of the tracker, instead of the scene's.")
    ] = None,
    head_ct: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="CT series of straight slices that is the head, without spheres."
        ),
    ] = None,
) -> None:
    """Print the full ground truth of a scene as TOML, as a starting point for your own scene."""
    import tomli_w

    from ronna_hw.marker_template import read_marker_template
    from sim.errors import BAD_SCENE
    from sim.world.process import load_scene
    from sim.world.scene.named_scenes import SCENES, add_patient_frame, draw_scene

    if head_ct is not None:
        if (
            scene not in SCENES
            or markers is not None
            or template is not None
            or fiducials is not Carrier.FREE
        ):
            raise BAD_SCENE("a CT of your own belongs to a named scene and has no spheres of the scene")
        from sim.world.scene.own_head import with_own_head

        truth = load_scene(scene, seed=seed, targets=targets, fiducials=Carrier.SURFACE, arm=arm)
        truth = with_own_head(truth, head_ct)
    elif template is None:
        truth = load_scene(scene, seed=seed, markers=markers, targets=targets, fiducials=fiducials, arm=arm)
    else:
        if scene not in SCENES or markers is not None or fiducials is not Carrier.FREE:
            raise BAD_SCENE("a template belongs to a named scene and fixes the number of markers")
        implanted = read_marker_template(template)
        truth = draw_scene(scene, seed=seed, targets=targets, template=implanted, arm=arm)
    if patient_frame:
        truth = add_patient_frame(truth)
    if tracker is not None:
        with_model = truth.tracker.model_copy(update={"model": tracker})
        truth = truth.model_copy(update={"tracker": with_model})
    typer.echo(tomli_w.dumps(truth.model_dump(mode="json", by_alias=True, exclude_none=True)), nl=False)
