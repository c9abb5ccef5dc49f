"""The theatre of a stereo calibration: started or configured, its devices checked as for a case."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.operators import ScriptedOperator, TerminalOperator
from procedures.cli.scene_choice import SceneChoice
from procedures.cli.simulated_theatre import SimulatedTheatre
from ronna_hw.devices.lifecycle import Lifecycle

if TYPE_CHECKING:
    from procedures.engine.step import StepContext
    from ronna_hw.config import Calibrations

OF_NOW = timedelta(hours=1)  # how long a record that only serves as a start is taken for valid


@dataclass(frozen=True)
class Source:
    """Where the devices are: a theatre file, or without one the simulated theatre to start."""

    config: Path | None
    choice: SceneChoice


def new_folder(out: Path) -> Path:
    """Make `OUT/<id>`; the id is the moment and four random hex digits."""
    folder = out / f"stereo-{datetime.now(UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(2)}"
    folder.mkdir(parents=True)
    return folder


@contextlib.contextmanager
def opened_room(
    source: Source, folder: Path, progress: Callable[[float], None], *, expired_too: bool = False
) -> Iterator[tuple[StepContext, Path]]:
    """Devices and operator as a step sees them, and the theatre file. Whatever happens, everything ends.

    With `expired_too` the records only serve as a start, and their age does not matter.
    """
    operator: ScriptedOperator | TerminalOperator = TerminalOperator()
    with contextlib.ExitStack() as stack:
        if source.config is None:
            theatre = SimulatedTheatre(*source.choice.arguments(), "--out", str(folder / "theatre"))
            stack.callback(theatre.stop)
            theatre.await_ready()
            theatre_file = theatre.file
            operator = stack.enter_context(contextlib.closing(ScriptedOperator(theatre.control)))
        else:
            theatre_file = source.config
        context = _context(theatre_file, folder, operator, progress)
        if expired_too:
            context = replace(context, calibrations=_of_now(context.calibrations))
        try:
            yield context, theatre_file
        finally:
            context.devices.stop()
            context.devices.close()


def set_up(context: StepContext) -> None:
    """Connect, check and configure all devices, as a case does; keep the result for the steps that follow."""
    from procedures.steps import set_up as step

    context.case.add("set_up", step.run(context).payload, ())


def activate(context: StepContext) -> None:
    """Start correction stream and cameras, where they are not running."""
    for device in (context.devices.arm, context.devices.stereo):
        if device.state is Lifecycle.CONFIGURED:
            device.activate()


def _context(
    theatre_file: Path,
    folder: Path,
    operator: ScriptedOperator | TerminalOperator,
    progress: Callable[[float], None],
) -> StepContext:
    from procedures.engine.case import Case
    from procedures.engine.devices import calibrations_of, make_devices
    from procedures.engine.step import StepContext, StepKey
    from ronna_hw.clock import open_clock
    from ronna_hw.config import read_theatre_file

    theatre = read_theatre_file(theatre_file)
    calibrations = calibrations_of(theatre)
    clock = open_clock(theatre.clock.endpoint)
    return StepContext(
        key=StepKey("stereo_calibration"),
        case=Case(folder, folder, folder),
        theatre=theatre,
        calibrations=calibrations,
        devices=make_devices(theatre, clock),
        clock=clock,
        operator=operator,
        trajectories=(),
        progress=lambda share, _text: progress(share),
        record_confirmation=lambda _question, _answer: None,
    )


def _of_now(calibrations: Calibrations) -> Calibrations:
    later = datetime.now(UTC) + OF_NOW
    return calibrations.model_copy(
        update={
            name: getattr(calibrations, name).model_copy(update={"expires": later})
            for name in ("stereo_head", "tool_tip", "tracker_frame")
        }
    )
