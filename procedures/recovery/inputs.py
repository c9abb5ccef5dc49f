"""CT, plan and proposed position after a restart: compared with those imported and checked."""

from __future__ import annotations

from procedures.engine.engine import Engine
from procedures.imaging.series import read_series
from procedures.planning.plan_file import read_plan
from procedures.recovery.comparison import Comparison
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.inputs import note_same_content
from procedures.steps.clinical.plan_check import CheckedPlan
from ronna_hw.errors import RonnaError


def compare_inputs(engine: Engine, comparison: Comparison, plan_sha256: str | None = None) -> None:
    """Read them again from their recorded paths; what cannot be read differs.

    `plan_sha256` is that of the plan that the run was opened with; it applies until the plan was checked.
    """
    clinical = engine.setting.clinical
    if clinical is None:
        return
    if imported := engine.case.find(ImportedCt, None):
        try:
            volume = read_series(clinical.series)
        except (RonnaError, OSError) as problem:
            comparison.differs("CT series", imported.result.series_instance_uid, problem)
        else:
            then = imported.result
            if changed := then.differences(volume):
                comparison.differs("CT series", then.series_instance_uid, f"a different one: {changed}")
            else:
                comparison.same("CT series")
                if engine.case.find(CheckedPlan, None) is None:
                    engine.setting.memory.keep(volume)
    if checked := engine.case.find(CheckedPlan, None):
        try:
            plan = read_plan(clinical.plan)
        except (RonnaError, OSError) as problem:
            comparison.differs("plan", "the checked plan", problem)
        else:
            if plan == checked.result.plan:
                comparison.same("plan")
                note_same_content(engine, clinical.plan, checked.record)
            else:
                comparison.differs("plan", "the checked plan", "a different one")
    elif plan_sha256 is not None and clinical.plan_sha256 not in (None, plan_sha256):
        comparison.differs("plan", f"SHA-256 {plan_sha256}", clinical.plan_sha256)
    if locked := engine.case.find(LockedCart, None):
        try:
            changed = locked.result.differences(clinical.place)
        except RonnaError as problem:
            comparison.differs("proposed position", "a readable one", problem)
        else:
            if changed:
                comparison.differs("proposed position", locked.record.identifier, changed)
            elif locked.result.proposal is not None:
                comparison.same("proposed position")
                note_same_content(engine, clinical.place, locked.record)
