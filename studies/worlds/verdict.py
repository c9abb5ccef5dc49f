"""Verdicts on cases, from the journal and the predictions compared with ground truth.

A target is warned of if the journal names it since the change: in a finding, a failed or refused step, or
voided or doubted results. An entry without a trajectory concerns the one of its step, or else all. Superseded
results concern only their own trajectories. Spheres hidden by the arm in a pose are noted in honest cases as
well: this warns of nothing unless the entry states its `targets`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from procedures.operator.question import Topic
from ronna_hw.evidence.journal_reading import Entry, Line, theatre_time_s
from ronna_hw.wire.room_tasks import INSERT, SEATED

WARNINGS = (Entry.FINDING, Entry.FAILED, Entry.REFUSED, Entry.VOIDED, Entry.DOUBTED)
SUPERSEDING = (Entry.VOIDED, Entry.DOUBTED)  # entries that name every target concerned
# Of sight in one pose, not of a result, and how two arms meet; these are findings of honest cases too.
USUAL = re.compile(
    r"fewer than three known spheres in this pose|not see the frame on the arm|has not seen the head for"
    r"|did not see the head[:,]|is watched in their place"
    r"|by the joints of both arms|by the tracker: the instrument is seen"
)
RESTART = re.compile(r"the program was not running")  # what a restart voids whatever has happened
GROSS = 2.0  # times the limit: no larger error may go unnoticed
LAST_LOCALIZATION = "relocalization"
UNUSUAL_TOPICS = frozenset(
    {
        *(Topic.CART_MOVED, Topic.CART_PLACE, Topic.GUARD, Topic.HEAD_UNSEEN, Topic.MOVED_SPHERE),
        *(Topic.MOVE_FOLLOWED, Topic.PAUSE, Topic.REGISTRATION_KEPT, Topic.REPEAT, Topic.RESUME),
        *(Topic.UNMATCHED_SPHERE, Topic.UNVERIFIED, Topic.WORK_BEGUN),
    }
)


class WorldVerdict(StrEnum):
    """Verdict on a case, from best to worst."""

    OK = "ok"
    WARNED = "warned"
    REFUSED = "refused"
    FALSE_FINDING = "FALSE FINDING"
    NO_VERDICT = "NO VERDICT"  # the case ended without a finding of the procedure
    SILENT = "SILENT"  # an error beyond its limit without a finding
    SILENT2 = "SILENT2"  # beyond twice its limit


RANKS = {verdict: rank for rank, verdict in enumerate(WorldVerdict)}


@dataclass(frozen=True)
class JudgedTarget:
    """A target reached by an instrument: true error, predicted limit, and whether it was warned about.

    The limit is 0 where none was predicted.
    """

    identifier: str
    error_mm: float
    limit_mm: float
    warned: bool

    @property
    def ratio(self) -> float:
        """Ratio of the error to its limit, infinite without a limit."""
        return self.error_mm / self.limit_mm if self.limit_mm > 0.0 else math.inf

    @property
    def verdict(self) -> WorldVerdict:
        if self.ratio <= 1.0:
            return WorldVerdict.OK
        if self.warned:
            return WorldVerdict.WARNED
        return WorldVerdict.SILENT2 if self.ratio > GROSS else WorldVerdict.SILENT


@dataclass(frozen=True)
class Judgement:
    """A judged case. `said` lists the warnings since the change, in order."""

    verdict: WorldVerdict
    targets: tuple[JudgedTarget, ...]
    happened: bool
    said: tuple[str, ...]
    error: str = ""

    @property
    def words(self) -> str:
        return self.verdict.value

    @property
    def worst(self) -> JudgedTarget | None:
        return worst_of(self.targets)


def worst_of(targets: Iterable[JudgedTarget]) -> JudgedTarget | None:
    """Return the target with the worst verdict, choosing the largest error-to-limit ratio among equals."""
    return max(targets, key=lambda one: (RANKS[one.verdict], one.ratio), default=None)


def limits_used_mm(lines: Iterable[Line], predictions: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return each target's predicted limit in mm, as valid when an instrument was inserted."""
    current_limits_mm: dict[str, float] = {}
    used: dict[str, float] = {}
    for line in lines:
        if line["entry"] == Entry.RESULT:
            current_limits_mm.update(predictions.get(str(line.get("record")), {}))
        elif line["entry"] == Entry.WORK and line.get("task") in (INSERT, SEATED):
            target = str(line.get("trajectory"))
            used[target] = current_limits_mm.get(target, 0.0)
    return used


def judge(
    lines: Sequence[Line],
    errors_mm: Mapping[str, float],
    limits_mm: Mapping[str, float],
    *,
    trajectories: Sequence[str],
    change: tuple[str, float] | None = None,
    done: bool = True,
    error: str = "",
    unusual: frozenset[Topic] = UNUSUAL_TOPICS,
) -> Judgement:
    """Judge a case by its journal. `change` is the step and delay of the change, or None for quiet cases.

    `errors_mm` are the true errors of the targets reached, `error` is the reason of a case that is
    not `done`, `unusual` are the topics of questions that count as warnings.
    """
    since_s = _find_localization_time_s(lines) if change is None else find_change_time_s(lines, *change)
    ended_s = theatre_time_s(lines[-1]) if lines else 0.0
    happened = change is not None and since_s <= ended_s
    touched, said = _collect_warnings(
        lines, _find_localization_time_s(lines) if not happened else since_s, trajectories, unusual
    )
    targets = tuple(
        JudgedTarget(one, error_mm, limits_mm.get(one, 0.0), one in touched)
        for one, error_mm in errors_mm.items()
    )
    verdicts = [one.verdict for one in targets]
    if not happened and said:
        verdicts.append(WorldVerdict.FALSE_FINDING)
    if not done:
        verdicts.append(WorldVerdict.REFUSED if error else WorldVerdict.NO_VERDICT)
    return Judgement(
        max(verdicts, key=RANKS.__getitem__, default=WorldVerdict.OK), targets, happened, said, error
    )


def _collect_warnings(
    lines: Iterable[Line], since_s: float, trajectories: Sequence[str], unusual: frozenset[Topic]
) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return the trajectories warned about since a given time, and all warnings."""
    touched: set[str] = set()
    said = []
    step = ""
    for line in lines:
        if line["entry"] == Entry.INTENT:
            step = str(line.get("step", ""))
        if theatre_time_s(line) < since_s:
            continue
        if line["entry"] in WARNINGS and not _is_usual(line):
            named = _find_named_trajectories(line, trajectories)
            if not named and line["entry"] not in SUPERSEDING:
                of_step = step.partition(":")[2]
                named = {of_step} if of_step else set(trajectories)
            touched |= named
            said.append(_format_warning(line))
        elif line["entry"] == Entry.CONFIRMATION:
            topic = str(line.get("topic")).partition(":")[0]
            if topic in unusual:
                said.append(f"asked: {line.get('subject')}")
    return frozenset(touched), tuple(said)


def _is_usual(line: Line) -> bool:
    words = _format_warning(line)
    is_finding = line["entry"] == Entry.FINDING and "targets" not in line
    return bool((is_finding and USUAL.search(words)) or RESTART.search(words))


def _find_named_trajectories(line: Line, trajectories: Sequence[str]) -> set[str]:
    text = json.dumps(dict(line))
    return {
        one for one in trajectories if re.search(rf"(?<![A-Za-z0-9]){re.escape(one)}(?![A-Za-z0-9])", text)
    }


def _format_warning(line: Line) -> str:
    words = line.get("text") or line.get("what") or line.get("error") or line.get("code") or ""
    return f"{line['entry']}: {words}"


def _find_localization_time_s(lines: Iterable[Line]) -> float:
    """Return the time of the last re-localization in s, or infinity if there was none."""
    done = [
        theatre_time_s(line)
        for line in lines
        if line["entry"] == Entry.RESULT and str(line.get("step")).partition(":")[0] == LAST_LOCALIZATION
    ]
    return max(done, default=math.inf)


def find_change_time_s(lines: Iterable[Line], step: str, after_s: float) -> float:
    """Return when a change begins: `step` is that of one trajectory, or that of each."""
    begun = (
        theatre_time_s(one)
        for one in lines
        if one["entry"] == Entry.INTENT
        and step in (str(one.get("step")), str(one.get("step")).partition(":")[0])
    )
    return next(begun, math.inf) + after_s
