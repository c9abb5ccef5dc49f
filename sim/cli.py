"""`ronna-sim`: the simulated theatre and each of its devices alone, for any client."""

from __future__ import annotations

import typer

from ronna_hw.command_line.console import run

app = typer.Typer(
    name="ronna-sim",
    help="Simulated devices that speak the real protocols, alone or as one theatre.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


def register(app: typer.Typer) -> None:
    """Add every command; their modules import nothing heavy until they run."""
    import importlib
    import importlib.util

    from sim.theatre.command import theatre, verify

    app.command()(theatre)
    app.command()(verify)
    for name in ("polaris", "kuka", "basler", "phantom"):
        if importlib.util.find_spec(f"sim.{name}.command") is None:
            continue  # lead: removed once every room has its command
        module = importlib.import_module(f"sim.{name}.command")
        app.command(name)(getattr(module, name))


register(app)


def main() -> None:
    """Entry point of the console script."""
    run(app)


if __name__ == "__main__":
    main()
