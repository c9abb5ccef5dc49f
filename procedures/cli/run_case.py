"""Runs one case from the command line: theatre, engine, verification, report."""

from __future__ import annotations

import contextlib
import importlib
import json
import math
import secrets
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from procedures.cli.operators import ScriptedOperator, TerminalOperator
from procedures.cli.scene_choice import SceneChoice
from procedures.cli.simulated_case import SimulatedCase
from procedures.engine.errors import CommandRefused
from procedures.engine.step import Progress
from ronna_hw.child_process import command
from ronna_hw.command_line.errors import PathProblem, UsageMistake, as_ronna_error

if TYPE_CHECKING:
    from procedures.engine.engine import Engine, Listener

VERIFY_TIMEOUT_S = 60.0


@dataclass(frozen=True)
class CaseRequest:
    """What the command line asks for."""

    out: Path
    choice: SceneChoice = field(default_factory=SceneChoice)
    strategy: str = "ocs"
    speed: str = "max"
    faults: Path | None = None
    config: Path | None = None  # a theatre file of configured endpoints, instead of a simulated theatre
    case: Path | None = None  # folder with ct/ and plan.toml, with `config`

    @property
    def seed(self) -> int | None:
        """Seed of a simulated case; None on configured endpoints."""
        return self.choice.own_seed if self.config is None else None


@dataclass(frozen=True)
class Watcher:
    """Who follows a run while it runs."""

    progress: Progress = lambda _share, _text: None
    listener: Listener = lambda _key, _outcome: None
    status: Callable[[str], None] = lambda _text: None
    safe_point: Callable[[], None] = lambda: None
    asking: Callable[[], AbstractContextManager[None]] = contextlib.nullcontext  # around a question


def new_run_folder(request: CaseRequest) -> Path:
    """Make `OUT/<run id>`; the id is the moment, the seed of a simulated case and four random hex digits."""
    seed = "" if request.seed is None else f"s{request.seed}-"
    folder = request.out / f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{seed}{secrets.token_hex(2)}"
    folder.mkdir(parents=True)
    return folder


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
            simulated.await_theatre()
            series, plan, theatre_file = simulated.series, simulated.plan, simulated.theatre_file
            operator = stack.enter_context(contextlib.closing(ScriptedOperator(simulated.control)))
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
    began = time.monotonic()
    with opened_engine(request, folder, watcher) as engine:
        engine.run_to()
        sim_s = engine.clock.now_s()
        results = _results(engine)
    truth = verify(folder) if request.config is None else {"ct": None, "targets": []}
    outcome = _outcome(request, folder, results, truth)
    outcome["sim_s"] = round(sim_s, 3)
    outcome["wall_s"] = round(time.monotonic() - began, 3)
    return outcome


def unfinished(request: CaseRequest, folder: Path, outcome: str, problem: BaseException) -> dict[str, Any]:
    """What `--json` prints for a run that did not end: the run, how it ended, and why."""
    error = as_ronna_error(problem) if isinstance(problem, Exception) else None
    return {
        "run": folder.name,
        "outcome": outcome,
        "seed": request.seed,
        "strategy": request.strategy,
        "error": None if error is None else {"code": error.code, "what": error.what},
    }


def check_request(request: CaseRequest) -> None:
    """Raise what can be known to be wrong before a run folder is made."""
    from ronna_hw.config import read_theatre_file

    if request.config is not None:
        read_theatre_file(request.config)
        for part in ("ct", "plan.toml"):
            path = (request.case or Path()) / part
            if not path.exists():
                raise PathProblem(f"{path} does not exist", awaited="a case folder with ct/ and plan.toml")
    if request.faults is not None and not request.faults.is_file():
        raise UsageMistake(f"there is no fault script {request.faults}", action="Give the path of a file.")


def forget_if_empty(folder: Path) -> None:
    """Remove a run folder in which nothing was written."""
    if not any(path.is_file() for path in folder.rglob("*")):
        shutil.rmtree(folder, ignore_errors=True)


def verify(folder: Path) -> dict[str, Any]:
    """Have the theatre's verifier compare the run with the truth."""
    answer = subprocess.run(
        command("sim.cli", "verify", str(folder), "--json"),
        capture_output=True,
        text=True,
        timeout=VERIFY_TIMEOUT_S,
        check=False,
    )
    if answer.returncode != 0:
        raise CommandRefused("ronna-sim verify", answer.stderr, answer.returncode)
    content: dict[str, Any] = json.loads(answer.stdout)
    return content


def _results(engine: Engine) -> dict[str, Any]:
    """What the run itself knows: residuals and predictions per trajectory, and the link's health."""
    case, trajectories = engine.case, engine.trajectories
    fits = {name: case.get("registration", name).payload for name in trajectories}
    links = [record.payload["link"] for record in case.records if "link" in record.payload]
    return {
        "n": fits[trajectories[0]]["pairs"],
        "fre_mm": [fits[name]["fre_mm"] for name in trajectories],
        "depths": {
            row["id"]: math.dist(row["entry_mm"], row["target_mm"])
            for row in case.get("plan_check").payload["plan"]["trajectories"]
        },
        "predicted": {name: fits[name]["predicted_tre_mm"] for name in trajectories},
        "markers": len(case.get("fiducial_localization").payload["markers"]),
        "late_cycles": sum(link["late_cycles"] + link["lost_cycles"] for link in links),
    }


def _outcome(
    request: CaseRequest, folder: Path, results: dict[str, Any], truth: dict[str, Any]
) -> dict[str, Any]:
    truths = {row["id"]: row for row in truth["targets"]}
    targets = [
        {
            "id": name,
            "depth_mm": results["depths"][name],
            "predicted_tre_mm": predicted,
            "application_error_mm": truths[name]["application_error_mm"] if name in truths else None,
        }
        for name, predicted in results["predicted"].items()
    ]
    errors = [row["application_error_mm"] for row in truth["targets"]]
    return {
        "run": folder.name,
        "outcome": "done",
        "seed": request.seed,
        "strategy": request.strategy,
        "markers": results["markers"],
        "ct": truth["ct"],
        "registration": {"n": results["n"], "fre_mm": results["fre_mm"]},
        "targets": targets,
        "mean_application_error_mm": sum(errors) / len(errors) if errors else None,
        "max_application_error_mm": max(errors) if errors else None,
        "late_cycles": results["late_cycles"],
    }


def report(folder: Path, outcome: dict[str, Any]) -> Path:
    """Write the report of a finished run."""
    from procedures.reporting.report import write_report

    return write_report(folder, outcome)
