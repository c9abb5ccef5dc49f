"""The how-to page on adding a step: its module runs unchanged between two steps of a case."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from add_a_step import PAGE
from clinical_case import ClinicalCell, given
from declaration_checks import reading_too_early, undescribed, without_unit
from force_sensor import UNSCALED_N, ScaledForceSensor
from prepared_results import mounted_guide

from procedures.engine.case import StepKey
from procedures.engine.machine import state_chart_mermaid
from procedures.engine.order import CaseOrder, order_of
from procedures.journal.errors import GateFailed
from procedures.journal.results import parse_record
from procedures.steps import catalogue as steps_catalogue
from procedures.steps import clinical
from ronna_hw.config import DeviceConfig
from ronna_hw.records import read_record


def order(force_check: ModuleType) -> CaseOrder:
    return order_of([given(mounted_guide()), force_check.STEP], ())


def with_force(cell: ClinicalCell, force_N: float) -> None:
    options = {"scale": force_N / UNSCALED_N}
    config = DeviceConfig(driver="force", endpoint="tcp://127.0.0.1:1", options=options)
    cell.opened.replace_device("device.force", ScaledForceSensor("device.force", config, cell.clock))


def test_the_new_step_reads_another_kind_of_device_and_stores_its_result(
    cell: ClinicalCell, force_check: ModuleType
) -> None:
    with_force(cell, 0.2)
    engine = cell.engine(order(force_check))
    engine.run_to()
    assert cell.case.get(force_check.UnloadedGuide).result.force_N == pytest.approx(0.2)
    record = cell.case.get(force_check.UnloadedGuide).record
    assert (record.identifier, list(record.parents)) == ("02-force_check", ["01-tool_change"])
    assert engine.machine.state == "finished"


def test_the_new_step_refuses_to_continue_while_something_presses_on_the_guide(
    cell: ClinicalCell, force_check: ModuleType
) -> None:
    with_force(cell, 2.0)
    with pytest.raises(GateFailed, match="something presses on the guide"):
        cell.engine(order(force_check)).run_to()


@pytest.fixture
def catalogue(force_check: ModuleType, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The catalogue with the two lines of the page, imported."""
    lines = re.findall(r"```text\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0]
    monkeypatch.setattr(clinical, "force_check", force_check, raising=False)
    source = Path(steps_catalogue.__file__).read_text(encoding="utf-8")
    before = lines.replace("    force_check.STEP,\n", "")
    assert before != lines
    assert source.count(before) == source.count("    fiducial_localization,\n") == 1
    source = source.replace(before, lines)
    source = source.replace("    fiducial_localization,\n", "    fiducial_localization,\n    force_check,\n")
    module = ModuleType("catalogue")
    monkeypatch.setitem(sys.modules, "catalogue", module)
    exec(compile(source, "catalogue.py", "exec"), module.__dict__)
    return module


def test_one_line_in_the_catalogue_adds_the_step_to_the_case_and_the_chart(catalogue: ModuleType) -> None:
    names = [str(key) for key in order_of(catalogue.CLINICAL_STEPS, ("T1",)).sequence]
    assert names.index("tool_check") < names.index("force_check") < names.index("positioning:T1")
    assert "tool_check --> force_check" in state_chart_mermaid(catalogue.CLINICAL_STEPS)


def test_the_new_step_declares_what_every_step_must(
    cell: ClinicalCell, catalogue: ModuleType, force_check: ModuleType
) -> None:
    for measures in (False, True):
        assert reading_too_early(catalogue.clinical_steps(measure_targets=measures)) == []
    kinds = [step.name for step in catalogue.clinical_steps(measure_targets=True)]
    assert len(set(kinds)) == len(kinds)
    model = force_check.UnloadedGuide
    assert (undescribed(model), without_unit(model), model.version) == ([], [], 1)
    result = model(force_N=0.1 + 0.2)
    stored = cell.case.store(StepKey(model.kind), result, ())
    record = read_record(cell.folder / "records" / f"{stored.record.identifier}.json")
    assert parse_record(record, model) == result
