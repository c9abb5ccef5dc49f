"""`ronna-plan place`: map of possible cart positions."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from procedures.cli import planning_inputs
from procedures.strategies.names import DEFAULT_STRATEGY, STRATEGY_NAMES
from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.options import require_output_folder

if TYPE_CHECKING:
    from procedures.planning.cart_map import PlaceProposal
    from procedures.planning.cart_place import CartCase
    from ronna_hw.frames import Transform

CHOSEN_BY_PLACE = "best"


def place(
    plan_file: planning_inputs.PlanArgument,
    series_dir: planning_inputs.PlannedSeriesOption,
    config: Annotated[
        Path, typer.Option("--config", metavar="FILE", help="Theatre file: its arm and surroundings.")
    ],
    robot_from_ct: Annotated[
        planning_inputs.SixNumbers | None,
        typer.Option(
            metavar="X Y Z A B C",
            help="Pose of the CT frame in $ROBROOT with the cart where it is assumed: "
            f"{planning_inputs.KUKA_ORDER}.",
        ),
    ] = None,
    robot_from_ct_of: Annotated[
        Path | None,
        typer.Option(
            metavar="RUN|FILE",
            help="Take that pose from a run's registration or a scene file, such as theatre/scene.json of a "
            "simulated run.",
        ),
    ] = None,
    robot_from_tracker: Annotated[
        planning_inputs.SixNumbers | None,
        typer.Option(
            metavar="X Y Z A B C",
            help="Likewise for the tracker: past the arm at home it must see the markers and its frame.",
        ),
    ] = None,
    strategy: Annotated[
        str,
        typer.Option(
            metavar="|".join(name for name in STRATEGY_NAMES if name != CHOSEN_BY_PLACE),
            help="How the stereo head is oriented at the markers.",
        ),
    ] = DEFAULT_STRATEGY,
    within: Annotated[
        float, typer.Option("--within", metavar="MM", min=60.0, max=1000.0, help="Extent of the map.")
    ] = 240.0,
    turned: Annotated[
        float,
        typer.Option(
            metavar="DEG", min=-180.0, max=180.0, help="Rotation of the cart, counter-clockwise from above."
        ),
    ] = 0.0,
    home: planning_inputs.HomeOption = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write place.json and the picture place.svg into DIR."),
    ] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Map possible cart positions and propose the one with the largest tolerance.

    Positions are those reached by pushing the cart from the assumed one, along x and y of its $ROBROOT, and
    turning it about its z by --turned. Each is judged as in the path check: every pose of the strategy, joint
    ranges, clearance, visibility for the stereo head and, with --robot-from-tracker, for the tracker. The map
    predicts what the coarse registration will find; it does not replace the path check.

    Exit codes: 0 a position was found, 1 a file is unusable, 2 usage, 3 there is none, 130 interrupted.
    """
    if out is not None:
        require_output_folder(out)
    began_s = time.perf_counter()
    if strategy == CHOSEN_BY_PLACE:
        raise UsageMistake(
            f"--strategy {strategy} chooses by the errors at one known cart position",
            action="Map with --strategy ocs: where that works, best can choose it.",
        )
    if (robot_from_ct is None) == (robot_from_ct_of is None):
        raise UsageMistake(
            "the assumed pose comes from --robot-from-ct or --robot-from-ct-of",
            expected="one of them",
            got="none" if robot_from_ct is None else "both",
            action="Give --robot-from-ct X Y Z A B C in mm and deg, or --robot-from-ct-of RUN.",
        )
    from procedures.planning.cart_map import map_places, open_judge, propose_place
    from procedures.planning.cart_place import CartCase
    from procedures.planning.guide import place_guides
    from procedures.planning.plan_check import check_plan, require_spheres
    from procedures.planning.plan_file import read_plan

    plan = read_plan(plan_file)
    require_spheres(plan)
    if robot_from_ct_of is not None:
        robot_from_ct = planning_inputs.read_assumed_pose(robot_from_ct_of, plan)
    assert robot_from_ct is not None
    theatre = planning_inputs.load_theatre_arm(config, robot_from_ct, home, strategy)
    assert theatre is not None
    volume, fiducials_mm, _ = planning_inputs.read_ct(series_dir, True)
    check_plan(
        plan,
        volume,
        fiducials_mm=fiducials_mm,
        bore=theatre.bore,
        plan_name=str(plan_file),
        ct_name=str(series_dir),
    ).require()
    assert fiducials_mm is not None
    marks = tuple(fiducials_mm)
    setting = theatre.with_scene(volume, plan.fiducials, marks)
    tracker = None if robot_from_tracker is None else _tracker_pose(robot_from_tracker)
    trajectories = place_guides(plan, theatre.bore)
    volume_mm = () if tracker is None else theatre.volume_mm
    case = CartCase(
        setting, trajectories, marks, theatre.sight, tracker, theatre.stereo_from_marker, volume_mm
    )
    with terminal.progress_bar("mapping cart positions") as advance, open_judge(case) as judge:
        proposal = propose_place(map_places(within, judge, advance, math.radians(turned)), judge)
    payload = {
        "series_instance_uid": plan.series_instance_uid,
        "assumed_robot_from_ct": list(robot_from_ct),
        "strategy": strategy,
        "sight": "judged" if tracker is not None else "not judged",
        **proposal.as_payload(),
        "elapsed_s": round(time.perf_counter() - began_s, 3),
    }
    if out is not None:
        _write_files(out, payload, proposal, case)
    if tracker is None:
        terminal.tell("sight not judged: without --robot-from-tracker markers or arm may be out of its sight")
    if as_json:
        terminal.print_json(payload)
        return
    _print_proposal(proposal)


def _tracker_pose(numbers: planning_inputs.SixNumbers) -> Transform:
    from ronna_hw.arm.pose import Pose
    from ronna_hw.frames import Frame, Transform

    pose = Pose.from_kuka(*numbers)
    return Transform.of(
        Frame.ROBOT, Frame.TRACKER, translation_mm=pose.position_mm, quaternion_wxyz=pose.quaternion()
    )


def _write_files(out: Path, payload: dict[str, Any], proposal: PlaceProposal, case: CartCase) -> None:
    from procedures.planning.cart_map import draw_place
    from ronna_hw.records import write_atomically

    try:
        out.mkdir(parents=True, exist_ok=True)
        write_atomically(out / "place.json", json.dumps(payload, indent=1).encode())
        write_atomically(out / "place.svg", draw_place(proposal, case))
    except OSError as error:
        raise UsageMistake(
            f"cannot write into {out}: {error.strerror}", action="Name another folder."
        ) from error


def _print_proposal(proposal: PlaceProposal) -> None:
    places, best = proposal.places, proposal.best
    at_assumed = "the assumed position works"
    if not proposal.assumed.serves:
        at_assumed = f"the assumed position does not work: {proposal.assumed.pose}: {proposal.assumed.reason}"
    terminal.tell(f"{at_assumed}; {places.allowed.mean():.0%} of the map works")
    headings = ["x mm", "y mm", "turned deg", "tolerance mm", "or half that, turned by deg"]
    push = [f"{best.x_mm:+.0f}", f"{best.y_mm:+.0f}", f"{math.degrees(best.turn_rad):+g}"]
    free = [f"{proposal.free_mm:.0f}", f"-{proposal.turns_deg[0]:g} to +{proposal.turns_deg[1]:g}"]
    terminal.print_table("push the cart from the assumed position by", headings, [push + free])
