"""Verdicts on adversarial cases: whether a case said a word of an error beyond what it states."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from procedures.operator.question import Topic
from ronna_hw.errors import EXIT_RECOVERY_NEEDED, EXIT_REFUSED, EXIT_SAFETY_STOP
from ronna_hw.evidence.journal_reading import Line
from studies.worlds.finished_case import FINISHED, IN_DOUBT, read_error_text
from studies.worlds.verdict import UNUSUAL_TOPICS, Judgement, judge, limits_used_mm

SILENT_RMS = 2.0  # times the stated rms: no larger error may go without a word
BINDS = "SIM-015"  # the theatre's staff could not bring the instrument to its stop
OF_THE_LOOKS = re.compile(
    r"STE-|REG-"
)  # codes: looks at spheres that do not agree, as none of a moving head does
OF_THE_PLAN = re.compile(
    r"PLAN-|STR-|ARM-007|CAL-003|CAL-010"
)  # codes: out of reach, too near, no clear path
ASKED = "asked: "
UNUSUAL = UNUSUAL_TOPICS - {Topic.RESUME, Topic.WORK_BEGUN}  # which every killed case asks


class CaseEnding(StrEnum):
    """How a case ended."""

    DONE = "done"
    QUESTION = "question"  # done, after a question that an undisturbed case does not ask
    IN_DOUBT = "in doubt"
    REFUSED = "refused"
    BOUND = "bound"  # an arm led the instrument into a guide that was elsewhere
    NOT_POSSIBLE = "not possible"  # what was planned cannot be reached, whether or not anything has changed
    BROKEN = "broken"  # without an error of the procedure


class Silence(StrEnum):
    """Verdict on a case, from best to worst."""

    NOT_POSSIBLE = "not possible"
    OK = "ok"
    TOLD = "told"
    REFUSED = "refused"
    BEYOND = "BEYOND"  # an error beyond its 95 % limit without a word, which chance brings about as well
    BROKEN = "BROKEN"
    SILENT = "SILENT"  # an error beyond twice its stated rms without a word, or a bound instrument


OF_ENDING = {
    CaseEnding.QUESTION: Silence.TOLD,
    CaseEnding.IN_DOUBT: Silence.TOLD,
    CaseEnding.REFUSED: Silence.REFUSED,
    CaseEnding.NOT_POSSIBLE: Silence.NOT_POSSIBLE,
    CaseEnding.BROKEN: Silence.BROKEN,
}
RANKS = {verdict: rank for rank, verdict in enumerate(Silence)}


@dataclass(frozen=True)
class UnderstoodTarget:
    """A target reached by an instrument: its true error, what was stated of it, and whether a word was said.

    Nothing stated counts as 0.
    """

    identifier: str
    error_mm: float
    rms_mm: float
    limit_mm: float
    told: bool

    @property
    def verdict(self) -> Silence:
        if self.told:
            return Silence.TOLD
        if self.error_mm > SILENT_RMS * self.rms_mm:
            return Silence.SILENT
        return Silence.BEYOND if self.error_mm > self.limit_mm else Silence.OK


@dataclass(frozen=True)
class JudgedCase:
    """A judged case. `said` lists its words since the change, in order."""

    verdict: Silence
    ending: CaseEnding
    targets: tuple[UnderstoodTarget, ...]
    happened: bool
    said: tuple[str, ...]
    error: str

    @property
    def words(self) -> str:
        return f"{self.verdict}, {self.ending}"

    @property
    def worst(self) -> UnderstoodTarget | None:
        """The target with the worst verdict, of equals that with the largest error to its rms."""
        return max(
            self.targets,
            key=lambda one: (RANKS[one.verdict], one.error_mm / one.rms_mm if one.rms_mm else 0.0),
            default=None,
        )


def judge_case(
    lines: Sequence[Line],
    printed: Mapping[str, Any],
    exit_code: int,
    errors_mm: Mapping[str, float],
    predictions: tuple[Mapping[str, Mapping[str, float]], Mapping[str, Mapping[str, float]]],
    *,
    trajectories: Sequence[str],
    change: tuple[str, float],
) -> JudgedCase:
    """Judge a case by its journal, what it printed, and the true errors.

    `predictions` are the stated rms and 95 % limits, by record; words before `change` do not count.
    """
    rms_mm, limits_mm = (limits_used_mm(lines, one) for one in predictions)
    found = judge(lines, errors_mm, limits_mm, trajectories=trajectories, change=change, unusual=UNUSUAL)
    error = read_error_text(printed)
    named = set(re.findall(r"\w+", error))  # what ends a case names the target that it is about
    targets = tuple(
        UnderstoodTarget(
            one.identifier,
            one.error_mm,
            rms_mm.get(one.identifier, 0.0),
            one.limit_mm,
            one.warned or one.identifier in named,
        )
        for one in found.targets
    )
    ending = _find_ending(printed, exit_code, error, found)
    verdicts = [one.verdict for one in targets]
    if ending is CaseEnding.BOUND:
        verdicts.append(Silence.TOLD if found.said else Silence.SILENT)
    elif ending in OF_ENDING:
        verdicts.append(OF_ENDING[ending])
    verdict = max(verdicts, key=RANKS.__getitem__, default=Silence.OK)
    return JudgedCase(verdict, ending, targets, found.happened, found.said, error)


def _find_ending(printed: Mapping[str, Any], exit_code: int, error: str, found: Judgement) -> CaseEnding:
    outcome = printed.get("outcome")
    if outcome == IN_DOUBT:
        return CaseEnding.IN_DOUBT
    if outcome in FINISHED:
        asked = any(one.startswith(ASKED) for one in found.said)
        return CaseEnding.QUESTION if asked else CaseEnding.DONE
    if BINDS in error:
        return CaseEnding.BOUND
    if OF_THE_PLAN.match(error):
        return CaseEnding.NOT_POSSIBLE
    # The last exit code: a room that is not as recorded.
    by_the_procedure = exit_code in (EXIT_REFUSED, EXIT_SAFETY_STOP, EXIT_RECOVERY_NEEDED)
    return CaseEnding.REFUSED if by_the_procedure or OF_THE_LOOKS.match(error) else CaseEnding.BROKEN
