"""First screen of the report: how the run ended, whether each target was met, and what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from procedures.journal.results import StepResult
from procedures.reporting.ending import Ending
from procedures.reporting.run_events import RunEvent, begun_insertions, last_held_name
from procedures.reporting.run_reading import RunReading
from procedures.reporting.tables import TargetTable
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.results import KnownBases, LeftOutSphere, RegisteredRobot, Relocalization


@dataclass(frozen=True)
class AssistantWork:
    """Trajectories at which the assistant began to lead something in, and at which the instrument went in."""

    begun: tuple[str, ...]
    done: tuple[str, ...]
    led: str = "instrument"  # last, or a drill

    @property
    def unfinished(self) -> tuple[str, ...]:
        """Trajectories at which the step did not end."""
        return tuple(name for name in self.begun if name not in self.done)


@dataclass(frozen=True)
class VerdictSection:
    """Ending of a run, its targets against the margin of the plan, and what cannot be relied on."""

    ending: Ending
    advice: str
    table: TargetTable
    in_doubt: Mapping[str, tuple[str, ...]]  # by target
    assistant: AssistantWork | None  # of two arms whose bases are known
    left_out: tuple[str, ...]
    moves: tuple[RunEvent, ...]
    unconfirmed: tuple[str, ...]
    problems: Sequence[str]

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons for doubt, each once."""
        return tuple(dict.fromkeys(reason for reasons in self.in_doubt.values() for reason in reasons))


def read_assistant_work(reading: RunReading) -> AssistantWork | None:
    """Read what the assistant did, or return None without two arms whose bases are known."""
    if reading.find(KnownBases) is None:
        return None
    reached = reading.valid_results(ReachedTarget)
    done = tuple(str(one.record.trajectory) for one in reached if one.result.assisted)
    journal = reading.run.journal
    return AssistantWork(begun_insertions(journal), done, last_held_name(journal))


def describe_exclusions(reading: RunReading) -> tuple[str, ...]:
    """Return a sentence for each trajectory and sphere that was left out."""
    sentences: list[str] = []
    models: tuple[type[StepResult], ...] = (Correspondence, CheckedPaths, Relocalization, RegisteredRobot)
    for stored in (stored for model in models for stored in reading.valid_results(model)):
        where = f" ({stored.record.trajectory})" if stored.record.trajectory else ""
        left_out = stored.result.leaves_out()
        sentences += [f"{name} was left out: {reason}" for name, reason in left_out.items()]
        sentences += [
            f"Sphere {one.fiducial + 1} was left out{where}: {one.reason}" for one in _spheres(stored.result)
        ]
    return tuple(sentences)


def _spheres(result: StepResult) -> tuple[LeftOutSphere, ...]:
    match result:
        case Correspondence() | Relocalization():
            return result.left_out
        case RegisteredRobot():
            return result.left_out_spheres
    return ()
