"""Runs one case from the command line: theatre or endpoints, engine, and the operator that goes with them."""

from __future__ import annotations

import contextlib
import importlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from procedures.cli.case.operators import ScriptedOperator, SimulatedRoom, TerminalOperator, TerminalRoom
from procedures.cli.case.outcome import CaseResults, finished
from procedures.cli.case.request import CaseRequest
from procedures.cli.case.simulated_case import SimulatedCase
from ronna_hw.command_line.messages import tell
from ronna_hw.log_output import keep_log

if TYPE_CHECKING:
    from procedures.engine.context import Progress
    from procedures.engine.engine import Engine, Listener
    from procedures.engine.operator import Operator, Room


@dataclass(frozen=True)
class CaseFiles:
    """What a case is made from: the theatre file, the CT series, the plan."""

    theatre: Path
    series: Path
    plan: Path

    @classmethod
    def of_folder(cls, theatre: Path, case: Path) -> Self:
        """Of a case folder with ct/ and plan.toml."""
        return cls(theatre, case / "ct", case / "plan.toml")


@dataclass(frozen=True)
class Watcher:
    """Who follows a run while it runs."""

    progress: Progress = lambda _share, _text: None
    listener: Listener = lambda _key, _outcome: None
    status: Callable[[str], None] = lambda _text: None
    safe_point: Callable[[], None] = lambda: None
    asking: Callable[[], AbstractContextManager[None]] = contextlib.nullcontext  # around a question


@contextlib.contextmanager
def opened_engine(request: CaseRequest, folder: Path, watcher: Watcher) -> Iterator[Engine]:
    """The engine of a case, ready to run its first step. Whatever happens, everything ends with it."""
    operator: Operator = TerminalOperator(watcher.asking)
    room: Room = TerminalRoom(watcher.asking)
    with contextlib.ExitStack() as stack:
        stack.enter_context(keep_log(folder, run=folder.name, seed=request.seed))
        if request.config is not None:
            files = CaseFiles.of_folder(request.config, request.case or Path())
        else:
            simulated = stack.enter_context(
                SimulatedCase(request.choice, folder, speed=request.speed, faults=request.faults)
            )
            watcher.status("making the phantom CT")
            importlib.import_module("procedures.steps.catalogue")  # a second of imports, meanwhile
            simulated.await_patient()
            watcher.status("opening the theatre")
            simulated.theatre.await_ready()
            files = CaseFiles(simulated.theatre.file, simulated.series, simulated.plan)
            operator = ScriptedOperator()
            room = stack.enter_context(contextlib.closing(SimulatedRoom(simulated.theatre.control)))
        engine = _make_engine(request, folder, files, operator, room, watcher)
        outcome = "failed"
        try:
            yield engine
            outcome = "done" if engine.upcoming is None else "left"
        except KeyboardInterrupt:
            outcome = "interrupted"
            raise
        finally:
            ignore_further_signals()
            if engine.instrument_in is not None:
                tell(f"the instrument is still in {engine.instrument_in}: the arm rests and will not move it")
            engine.close(outcome)


def ignore_further_signals() -> None:
    """From here on everything ends anyway; a second signal would only tear the ending apart."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _make_engine(
    request: CaseRequest, folder: Path, files: CaseFiles, operator: Operator, room: Room, watcher: Watcher
) -> Engine:
    from procedures.engine.case import Case
    from procedures.engine.context import CaseSetting
    from procedures.engine.engine import Engine
    from procedures.engine.journal import Entry, Journal
    from procedures.engine.order import order_of
    from procedures.planning.plan_file import read_plan
    from procedures.steps.catalogue import CLINICAL_STEPS
    from procedures.strategies.catalogue import strategy_named
    from procedures.workcell import Workcell
    from ronna_hw.theatre import Theatre

    strategy = strategy_named(request.strategy)
    plan = read_plan(files.plan)
    theatre = Theatre.from_file(files.theatre)
    journal = Journal(folder)
    workcell = Workcell(theatre, journal)
    journal.write(
        Entry.OPENED,
        theatre.clock.now_s(),
        theatre=theatre.file.theatre,
        banner=theatre.file.banner,
        strategy=request.strategy,
        seed=request.seed,
    )
    return Engine(
        order_of(
            CLINICAL_STEPS,
            [trajectory.id for trajectory in plan.trajectories],
            localizes_per_trajectory=strategy.localizes_per_trajectory,
        ),
        Case(folder, files.series, files.plan),
        CaseSetting(
            workcell=workcell,
            clock=theatre.clock,
            operator=operator,
            room=room,
            settings=theatre.file.procedure,
            surroundings=theatre.file.cell,
            strategy=strategy,
            theatre=theatre,
            progress=watcher.progress,
        ),
        journal,
        listener=watcher.listener,
        safe_point=watcher.safe_point,
        on_ending=ignore_further_signals,
    )


def run_case(request: CaseRequest, folder: Path, watcher: Watcher) -> dict[str, Any]:
    """Run a whole case and return what `--json` prints, without the report; raises what a step raises."""
    began_s = time.monotonic()
    with opened_engine(request, folder, watcher) as engine:
        engine.run_to()
        results = CaseResults.of(engine)
    return {**finished(request, folder, results), "wall_s": round(time.monotonic() - began_s, 3)}
