"""`ronna-sim`: simulates the whole theatre, or any single device, for any client."""

from __future__ import annotations

import ronna_hw.command_line.early_interruption
import ronna_hw.host.process  # noqa: F401 - first of all: a parent that dies during the imports is still noticed

# isort: split
import typer

from ronna_hw.command_line.terminal import run
from ronna_hw.host.process import suspend_garbage_collection

app = typer.Typer(
    name="ronna-sim",
    help="Simulated devices that speak the real protocols, alone or as one theatre.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


def register(app: typer.Typer) -> None:
    """Register all commands, deferring heavy imports until a command runs."""
    from sim.basler.command import basler
    from sim.kuka.command import kuka
    from sim.phantom.command import phantom
    from sim.polaris.command import polaris
    from sim.running_command import env, list_command, stop_command
    from sim.theatre.command import fault, mount, move, scene, stand, theatre, verify, work
    from sim.universal_robots.command import ur

    for command in (theatre, polaris, kuka, ur, basler, phantom, scene, mount, stand, move, fault, verify):
        app.command()(command)
    app.command(context_settings={"ignore_unknown_options": True})(
        work
    )  # negative joint angles look like options
    app.command()(env)
    app.command("list")(list_command)
    app.command("stop")(stop_command)


register(app)


def main() -> None:
    """Entry point of the console script."""
    suspend_garbage_collection()  # ends with the READY line
    run(app)


if __name__ == "__main__":
    main()
