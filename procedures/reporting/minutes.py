"""Where the time of a run went, from its journal: phases and steps, and people's part in them.

Theatre time is that of the procedure; with real devices it is wall-clock time, while a simulated theatre in
lock-step adds none while the computer works or a script answers. Host time is what the computer took.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from procedures.journal.journal import ENDS_OF_A_STEP, Entry, Line, theatre_time_s
from procedures.steps.catalogue import clinical_steps

PHASE, STEP, QUESTION, HANDS = "phase", "step", "question", "hands"
# Thesis 5.1: time to find the markers in a CT, by an operator and by the algorithm.
OPERATOR_S, ALGORITHM_S = 191.5, 28.8
LOCALIZATION = "fiducial_localization"
OUTSIDE = "outside the steps"
PHASES: Mapping[str, str] = {step.name: step.phase.value for step in clinical_steps(measure_targets=True)}


@dataclass(frozen=True)
class TimeTaken:
    """Total of one phase, step, or human action."""

    kind: str
    name: str
    count: int
    theatre_s: float
    host_s: float | None  # unknown for an answer: the journal has only its end


def times_taken(journal: Sequence[Line]) -> tuple[TimeTaken, ...]:
    """Phases and steps in the order of their first occurrence, then questions and manual work.

    Steps of all trajectories are added up. A step that was restarted counts again; one that never ended
    counts until the last line of its program.
    """
    found: dict[tuple[str, str], list[tuple[float, float | None]]] = {}

    def add(kind: str, name: str, theatre_s: float, host_s: float | None) -> None:
        found.setdefault((kind, name), []).append((theatre_s, host_s))

    begun: Line | None = None
    before: Line | None = None
    for line in (*journal, None):
        over = line is None or line["entry"] == Entry.RESTARTED  # with it the clock of its program
        ends = line is None or over or line["entry"] == Entry.INTENT or line["entry"] in ENDS_OF_A_STEP
        last, before = before if over else line, line
        if begun is not None and last is not None and ends:
            name = str(begun.get("step", "")).partition(":")[0]
            took = theatre_time_s(last) - theatre_time_s(begun), _host_s(begun, last)
            add(PHASE, PHASES.get(name, OUTSIDE), *took)
            add(STEP, name, *took)
            begun = None
        if line is None:
            break
        if line["entry"] == Entry.INTENT:
            begun = line
        elif line["entry"] == Entry.CONFIRMATION:
            add(QUESTION, _topic(line.get("topic")), _since(line, "asked_s"), None)
        elif line["entry"] == Entry.WORK:
            add(HANDS, str(line.get("task", "")), _since(line, "began_s"), None)
    kinds = (PHASE, STEP, QUESTION, HANDS)
    return tuple(
        TimeTaken(
            kind,
            name,
            len(each),
            sum(theatre_s for theatre_s, _ in each),
            sum(host_s or 0.0 for _, host_s in each) if kind in (PHASE, STEP) else None,
        )
        for (kind, name), each in sorted(found.items(), key=lambda item: kinds.index(item[0][0]))
    )


def _topic(topic: object) -> str:
    return str(topic).partition(":")[0]


def _since(line: Line, key: str) -> float:
    """Theatre time since the time under that key; none if the journal does not have it."""
    began = line.get(key)
    return max(0.0, theatre_time_s(line) - float(began)) if isinstance(began, int | float) else 0.0


def _host_s(begin: Line, end: Line) -> float:
    try:
        moments = [datetime.fromisoformat(str(line["host_time"])) for line in (begin, end)]
    except (KeyError, ValueError):
        return 0.0
    return max(0.0, (moments[1] - moments[0]).total_seconds())
