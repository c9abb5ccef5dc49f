"""The theatre of a stereo calibration, started or configured, and the engine that runs its steps."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.operators import ScriptedOperator, SimulatedRoom, TerminalOperator, TerminalRoom
from procedures.cli.case.request import forget_if_empty
from procedures.cli.case.running import ignore_further_signals
from procedures.cli.case.scene_choice import SceneChoice
from procedures.cli.case.simulated_theatre import SimulatedTheatre
from ronna_hw.log_output import keep_log

if TYPE_CHECKING:
    from procedures.engine.engine import Engine
    from procedures.engine.operator import Operator, Room
    from procedures.engine.order import Steps
    from ronna_hw.config import Calibrations

GRACE = timedelta(hours=1)  # how long a record that only serves as a start is taken for valid


@dataclass(frozen=True)
class Source:
    """Where the devices are: a theatre file, or without one the simulated theatre to start."""

    config: Path | None
    choice: SceneChoice


def new_folder(out: Path, what: str) -> Path:
    """Make `OUT/<what>-<id>`; the id is the moment and four random hex digits."""
    folder = out / f"{what}-{datetime.now(UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(2)}"
    folder.mkdir(parents=True)
    return folder


def run_steps(
    source: Source,
    folder: Path,
    steps: Steps,
    progress: Callable[[float], None],
    *,
    expired_too: bool = False,
) -> Engine:
    """Run a calibration's steps to their end, and close everything; the engine holds the results.

    With `expired_too` the records only serve as a start, and their age does not matter.
    """
    try:
        with _opened(source, folder, steps, progress, expired_too=expired_too) as engine:
            engine.run_to()
    except BaseException:  # also an interruption: a folder that holds nothing is no run
        forget_if_empty(folder)
        raise
    return engine


@contextlib.contextmanager
def _opened(
    source: Source, folder: Path, steps: Steps, progress: Callable[[float], None], *, expired_too: bool
) -> Iterator[Engine]:
    from procedures.engine.case import Case
    from procedures.engine.context import CaseSetting
    from procedures.engine.engine import Engine
    from procedures.engine.journal import Entry, Journal
    from procedures.engine.order import order_of
    from procedures.strategies.catalogue import strategy_named
    from procedures.workcell import Workcell
    from ronna_hw.theatre import Theatre

    operator: Operator = TerminalOperator()
    room: Room = TerminalRoom()
    with contextlib.ExitStack() as stack:
        stack.enter_context(keep_log(folder, run=folder.name))
        file = source.config
        if file is None:
            simulated = SimulatedTheatre(*source.choice.arguments(), "--out", str(folder / "theatre"))
            stack.callback(simulated.stop)
            simulated.await_ready()
            file = simulated.file
            operator = ScriptedOperator()
            room = stack.enter_context(contextlib.closing(SimulatedRoom(simulated.control)))
        theatre = stack.enter_context(Theatre.from_file(file))
        theatre.require("tracker", "stereo", "robot.master")
        calibrations = _valid_now(theatre.calibrations) if expired_too else theatre.calibrations
        journal = Journal(folder)
        journal.write(
            Entry.OPENED, theatre.clock.now_s(), theatre=theatre.file.theatre, banner=theatre.file.banner
        )
        setting = CaseSetting(
            workcell=Workcell(theatre, journal, calibrations=calibrations),
            clock=theatre.clock,
            operator=operator,
            room=room,
            settings=theatre.file.procedure,
            surroundings=theatre.file.cell,
            strategy=strategy_named("ocs"),  # for the steps of a case; a calibration has none
            theatre=theatre,
            progress=lambda share, _text: progress(share),
        )
        engine = Engine(
            order_of(steps, ()),
            Case(folder, folder, folder),
            setting,
            journal,
            on_ending=ignore_further_signals,
        )
        outcome = "failed"
        try:
            yield engine
            outcome = "done"
        finally:
            engine.close(outcome)


def _valid_now(calibrations: Calibrations) -> Calibrations:
    later = datetime.now(UTC) + GRACE
    return calibrations.model_copy(
        update={
            name: getattr(calibrations, name).model_copy(update={"expires": later})
            for name in ("stereo_head", "tool_tip", "tracker_frame")
        }
    )
