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
from typing import TYPE_CHECKING, Any

from procedures.cli.case_outcome import CaseResults, finished
from procedures.cli.case_request import CaseRequest
from procedures.cli.operators import ScriptedOperator, TerminalOperator
from procedures.cli.simulated_case import SimulatedCase
from procedures.engine.step import Progress

if TYPE_CHECKING:
    from procedures.engine.engine import Engine, Listener


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
    operator: ScriptedOperator | TerminalOperator = TerminalOperator(watcher.asking)
    with contextlib.ExitStack() as stack:
        if request.config is not None:
            series = (request.case or Path()) / "ct"
            plan = (request.case or Path()) / "plan.toml"
            theatre_file = request.config
        else:
            simulated = stack.enter_context(
                SimulatedCase(request.choice, folder, speed=request.speed, faults=request.faults)
            )
            watcher.status("making the phantom CT")
            importlib.import_module("procedures.steps.catalogue")  # a second of imports, meanwhile
            simulated.await_patient()
            watcher.status("opening the theatre")
            simulated.theatre.await_ready()
            series, plan, theatre_file = simulated.series, simulated.plan, simulated.theatre.file
            operator = stack.enter_context(contextlib.closing(ScriptedOperator(simulated.theatre.control)))
        engine = _make_engine(request, folder, (series, plan, theatre_file), operator, watcher)
        outcome = "failed"
        try:
            yield engine
            outcome = "done" if engine.upcoming is None else "left"
        except KeyboardInterrupt:
            outcome = "interrupted"
            raise
        finally:
            ignore_further_signals()
            engine.close(outcome)


def ignore_further_signals() -> None:
    """From here on everything ends anyway; a second signal would only tear the ending apart."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _make_engine(
    request: CaseRequest,
    folder: Path,
    inputs: tuple[Path, Path, Path],
    operator: ScriptedOperator | TerminalOperator,
    watcher: Watcher,
) -> Engine:
    from procedures.engine.case import Case
    from procedures.engine.devices import make_devices
    from procedures.engine.engine import Engine
    from procedures.engine.journal import Entry, Journal
    from procedures.planning.plan_file import read_plan
    from procedures.steps.catalogue import STEPS
    from procedures.strategies.catalogue import strategy_named
    from ronna_hw.clock import open_clock
    from ronna_hw.config import read_theatre_file

    series, plan_path, theatre_path = inputs
    strategy_named(request.strategy)
    theatre = read_theatre_file(theatre_path)
    plan = read_plan(plan_path)
    clock = open_clock(theatre.clock.endpoint)
    journal = Journal(folder)
    journal.write(
        Entry.OPENED,
        clock.now_s(),
        theatre=theatre.theatre,
        banner=theatre.banner,
        strategy=request.strategy,
        seed=request.seed,
    )
    return Engine(
        steps=STEPS,
        trajectories=tuple(trajectory.id for trajectory in plan.trajectories),
        case=Case(folder, series, plan_path),
        theatre=theatre,
        devices=make_devices(theatre, clock),
        clock=clock,
        operator=operator,
        journal=journal,
        progress=watcher.progress,
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
