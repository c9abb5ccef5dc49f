"""`ronna-sim env`, `list` and `stop`: this user's running simulators."""

from __future__ import annotations

from typing import Annotated

import typer

from ronna_hw.command_line.terminal import JsonOption, print_json, print_table, say, tell

CellArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="[CELL]",
        help="Its name in ronna-sim list, its process number, or a theatre's folder "
        "[default: the only one that is running].",
    ),
]


def env(cell: CellArgument = None) -> None:
    """Print the endpoints of a running simulator as shell variables: eval "$(ronna-sim env CELL)".

    RONNA_CONTROL is the control port, THEATRE the theatre file, LINE the tracker, CONTROLLER and STREAM a
    KUKA arm, ARM the address of a Universal Robots arm, LEFT and RIGHT the cameras, CLOCK the clock. Those
    of an assistant are ASSISTANT_CONTROLLER, ASSISTANT_STREAM and ASSISTANT_ARM.
    RONNA_CONTROL contains the secret token. Without such a simulator the eval fails, and unsets them.
    """
    from ronna_hw.errors import RonnaError
    from sim.world.running import NO_VARIABLES, find_running

    try:
        lines = tuple(find_running(cell).shell_lines())
    except RonnaError:
        say(NO_VARIABLES)
        raise
    for line in lines:
        say(line)


def list_command(as_json: JsonOption = False) -> None:
    """List this user's running simulators."""
    from sim.world.running import read_register

    running, bad = read_register()
    for path in bad:
        tell(f"warning: {path} is no entry of a simulator and was skipped; delete it")
    if as_json:
        rows = [
            {
                "name": one.name,
                "pid": one.pid,
                "device": one.ready["device"],
                "background": one.in_background,
                "folder": None if one.folder is None else str(one.folder),
            }
            for one in running
        ]
        print_json({"running": rows})
        return
    if not running:
        tell("no simulator of this user is running")
        return
    print_table(
        "Running simulators",
        ("name", "pid", "device", "ends with", "folder"),
        [
            (
                one.name,
                one.pid,
                one.ready["device"],
                f"ronna-sim stop {one.argument}" if one.in_background else "its terminal or run",
                one.folder or "",
            )
            for one in running
        ],
    )


def stop_command(cell: CellArgument = None) -> None:
    """Stop a simulator that runs in the background, with all its devices."""
    from sim.world.background import stop
    from sim.world.running import find_running

    running = find_running(cell)
    stop(running)
    tell(f"{running.name} has ended")
