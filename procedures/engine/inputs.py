"""Whether the results that a step reads are there, and may still be acted on."""

from __future__ import annotations

from procedures.engine.case import Case
from procedures.engine.step import StepKey, StepSpec
from procedures.journal.results import StepResult


def unusable_inputs(case: Case, spec: StepSpec[StepResult], key: StepKey) -> tuple[str, ...]:
    """What keeps the step from reading what it needs; empty when it may.

    Results of a trajectory that was finished before something moved are there to be shown: nothing moves by
    them again.
    """
    found = {model: case.find(model, key.trajectory) for model in spec.reads}
    where = f" for {key.trajectory}" if key.trajectory else ""
    missing = tuple(f"no result of {model.kind}{where}" for model, one in found.items() if one is None)
    read = [one.record.identifier for one in found.values() if one is not None]
    past = [identifier for identifier in read if identifier in case.past]
    return missing or ((f"made before something moved: {', '.join(past)}",) if past else ())
