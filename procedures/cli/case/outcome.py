"""What a run came to, as `--json` prints it: what the run itself knows, and the truth where there is one."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from procedures.cli.case.request import CaseRequest
from procedures.engine.errors import CommandRefused
from ronna_hw.command_line.errors import as_ronna_error
from ronna_hw.host.child_process import command

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

VERIFY_TIMEOUT_S = 60.0  # host time; it reads a few small files
NO_TRUTH: dict[str, Any] = {"ct": None, "targets": []}  # of a run on configured endpoints


@dataclass(frozen=True)
class CaseResults:
    """What the run itself knows at its end. Trajectories are in the order of the plan."""

    markers: int  # found in the CT
    pairs: int
    fre_mm: tuple[float, ...]
    depth_mm: dict[str, float]
    predicted_mm: dict[str, float]  # rms, per trajectory
    late_cycles: int  # late or lost, over all sessions of the robot link
    theatre_time_s: float

    @classmethod
    def of(cls, engine: Engine) -> Self:
        """The results of a case that has run to its end."""
        from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
        from procedures.steps.clinical.plan_check import CheckedPlan
        from procedures.steps.clinical.registration import RegisteredRobot
        from procedures.steps.clinical.retreat import Retreated
        from procedures.steps.clinical.tool_change import MountedGuide

        case = engine.case
        fits = {name: case.get(RegisteredRobot, name).result for name in engine.order.trajectories}
        retreats = [case.get(Retreated, name).result.link for name in engine.order.trajectories]
        links = [case.get(MountedGuide).result.link, *(link for link in retreats if link is not None)]
        return cls(
            markers=len(case.get(LocalizedFiducials).result.markers),
            pairs=next(iter(fits.values())).pairs,
            fre_mm=tuple(fit.fre_mm for fit in fits.values()),
            depth_mm={one.id: one.depth_mm for one in case.get(CheckedPlan).result.plan.trajectories},
            predicted_mm={name: fit.prediction(name).rms_mm for name, fit in fits.items()},
            late_cycles=sum(link.late_cycles + link.lost_cycles for link in links),
            theatre_time_s=engine.setting.clock.now_s(),
        )


def finished(request: CaseRequest, folder: Path, results: CaseResults) -> dict[str, Any]:
    """What `--json` prints for a run that is done, without its report; a simulated one is held to the truth.

    Raises PRO-013 when the verifier fails.
    """
    truth = _truth(folder) if request.config is None else NO_TRUTH
    errors_mm = {row["id"]: row["application_error_mm"] for row in truth["targets"]}
    return {
        "run": folder.name,
        "outcome": "done",
        "seed": request.seed,
        "strategy": request.strategy,
        "markers": results.markers,
        "ct": truth["ct"],
        "registration": {"n": results.pairs, "fre_mm": list(results.fre_mm)},
        "targets": [
            {
                "id": name,
                "depth_mm": results.depth_mm[name],
                "predicted_tre_mm": predicted_mm,
                "application_error_mm": errors_mm.get(name),
            }
            for name, predicted_mm in results.predicted_mm.items()
        ],
        "mean_application_error_mm": sum(errors_mm.values()) / len(errors_mm) if errors_mm else None,
        "max_application_error_mm": max(errors_mm.values(), default=None),
        "late_cycles": results.late_cycles,
        "sim_s": round(results.theatre_time_s, 3),
    }


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


def _truth(folder: Path) -> dict[str, Any]:
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
