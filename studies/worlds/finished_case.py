"""What a finished case left behind: what it printed, what it stated of its targets, and the truth."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ronna_hw.evidence.manifest import RECORDS_FOLDER
from ronna_hw.host.child_process import command, run_command
from ronna_hw.records import read_record
from studies.errors import WORLD_NOT_RUN

VERIFY_LIMIT_S = 120.0
NO_TARGET = "SIM-006"
IN_DOUBT = "in doubt"
FINISHED = ("done", IN_DOUBT, "missed")  # outcomes of a case whose steps were all done
LIMIT, RMS = "limit_mm", "rms_mm"  # figures of a predicted error


def read_true_errors_mm(run: Path) -> dict[str, float]:
    """Return the true error of each target that an instrument reached; raises STU-015."""
    ended = run_command("ronna-sim verify", command("sim.cli", "verify", str(run), "--json"), VERIFY_LIMIT_S)
    if not ended.stdout and NO_TARGET not in ended.stderr:  # else no instrument reached a target
        raise WORLD_NOT_RUN(f"{run.name} cannot be judged: {ended.stderr[-300:]}")
    targets = json.loads(ended.stdout)["targets"] if ended.stdout else []
    return {str(one["id"]): float(one["application_error_mm"]) for one in targets}


def read_predictions(run: Path, figure: str = LIMIT) -> dict[str, dict[str, float]]:
    """Return a figure of the predicted error of each target, by record."""
    found: dict[str, dict[str, float]] = {}
    for path in sorted((run / RECORDS_FOLDER).glob("*.json")):
        record = read_record(path)
        predicted: Any = record.payload.get("predictions") or ()
        found[record.identifier] = {str(one["target"]): float(one[figure]) for one in predicted}
    return found


def parse_output(output: str) -> dict[str, Any]:
    """Return what a command printed with `--json`, or an empty object."""
    try:
        printed: dict[str, Any] = json.loads(output)
    except ValueError:
        return {}
    return printed


def read_error_text(printed: Mapping[str, Any]) -> str:
    """Return the code and message of the error that ended a run, or an empty string."""
    error = printed.get("error") or {}
    return f"{error.get('code')}: {error.get('what')}" if error else ""
