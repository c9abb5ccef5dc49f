"""Command-line options for calibrations and measurements."""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from procedures.cli.case.options import TheatreOptions
from procedures.runs.request import CalibrationProcedure, RunRequest
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.terminal import JsonOption

if TYPE_CHECKING:
    from ronna_hw.calibration import Numbers3

USED_TO_RECOMPUTE = frozenset({"recorded", "config", "update", "days", "out", "as_json"})


@dataclass(frozen=True)
class MeasuringOptions(TheatreOptions):
    """Options for measuring in a theatre, including the output folder."""

    out: Annotated[Path, typer.Option(help="Output folder.")] = Path("calibrations")
    as_json: JsonOption = False


@dataclass(frozen=True)
class CalibrationOptions(MeasuringOptions):
    """Calibration options: where measurements come from and where the records go."""

    recorded: Annotated[
        Path | None,
        typer.Option("--from", metavar="FOLDER", help="Recompute from the measurements in this folder."),
    ] = None
    days: Annotated[int, typer.Option(min=1, max=366, help="Validity of the records, in days.")] = 30
    update: Annotated[
        bool,
        typer.Option(
            "--update", help="Put the new records into the theatre file --config; it keeps a history."
        ),
    ] = False

    def calibrate(
        self, context: typer.Context, of: str, looks: int, more: int, ball_mm: Numbers3 | None = None
    ) -> None:
        """Calibrate from new or recorded measurements; the arguments are those of a `Recipe`."""
        require_finite_ball(ball_mm)
        theatre = self.source(context)
        from procedures.cli.calibrating.calibration import calibrate
        from procedures.steps.calibration.recipe import Calibrated, Recipe

        recipe = Recipe(of=Calibrated(of), looks=looks, more=more, ball_mm=ball_mm).model_dump(mode="json")
        procedure = CalibrationProcedure(recipe=recipe, days=self.days, update=self.update)
        request = replace(theatre, procedure=procedure)
        calibrate(request, self.recorded, self.out, as_json=self.as_json)

    def source(self, context: typer.Context) -> RunRequest:
        """Return the run request for a theatre to measure in, or for recomputing from recorded measurements.

        Raises CLI-001 unless each input has one source.

        `context` is the command's: it knows which of all its options were typed.
        """
        has_no_source = self.recorded is None and not self.sim and self.config is None
        if has_no_source or (self.recorded is not None and self.sim):
            raise UsageMistake(
                "choose one: --sim, --config FILE, or --from FOLDER",
                action="--sim measures in a simulated theatre, --config on your devices, --from recomputes.",
            )
        if self.update and self.config is None:
            raise UsageMistake(
                "--update needs the theatre file to put the records into: --config FILE",
                action="Add --config FILE, or omit --update: the records are written to --out.",
            )
        if self.recorded is not None and (idle := _list_other_options(context, USED_TO_RECOMPUTE)):
            raise UsageMistake(
                f"{idle} and --from cannot be combined",
                action="Omit it: nothing is measured, the measurements in the folder are used.",
            )
        return self.theatre() if self.recorded is None else RunRequest(config=self.config)


def _list_other_options(context: typer.Context, names: Set[str]) -> str:
    return ", ".join(
        parameter.opts[0]
        for parameter in context.command.params
        if parameter.expose_value  # the others are those that every command has
        and parameter.name not in names
        and (source := context.get_parameter_source(str(parameter.name))) is not None
        and source.name == "COMMANDLINE"
    )


def require_finite_ball(ball_mm: Numbers3 | None) -> Numbers3 | None:
    """Return the `--ball` position in mm. Raises CLI-001 unless it is finite."""
    if ball_mm is not None and not all(map(math.isfinite, ball_mm)):
        got = " ".join(f"{value:g}" for value in ball_mm)
        raise UsageMistake(
            "--ball needs three finite numbers",
            expected="X Y Z in $ROBROOT, mm",
            got=got,
            action="Give it to within 10 mm, or omit it: then the tracker finds the ball.",
        )
    return ball_mm
