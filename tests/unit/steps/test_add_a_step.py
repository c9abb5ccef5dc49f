"""The how-to page on adding a step: its module runs unchanged between two steps of a case."""

from __future__ import annotations

import re
from types import ModuleType

import pytest
from add_a_step import PAGE
from clinical_case import ClinicalCell, given
from force_sensor import UNSCALED_N, ScaledForceSensor
from prepared_results import mounted_guide

from procedures.engine.machine import mermaid
from procedures.engine.order import CaseOrder, order_of
from procedures.results.errors import GateFailed
from procedures.steps.catalogue import CLINICAL_STEPS
from ronna_hw.config import DeviceConfig


def order(force_check: ModuleType) -> CaseOrder:
    return order_of([given(mounted_guide()), force_check.STEP], ())


def with_force(cell: ClinicalCell, force_N: float) -> None:
    options = {"scale": force_N / UNSCALED_N}
    config = DeviceConfig(driver="force", endpoint="tcp://127.0.0.1:1", options=options)
    cell.opened._devices["device.force"] = ScaledForceSensor("device.force", config, cell.clock)


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


def test_one_line_in_the_catalogue_adds_the_step_to_the_case_and_the_chart(
    force_check: ModuleType,
) -> None:
    lines = re.findall(r"```text\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0]
    before = re.search(r"(\w+)\.STEP,\n\s+force_check\.STEP", lines)
    assert before, lines
    place = 1 + [step.name for step in CLINICAL_STEPS].index(before[1])
    steps = (*CLINICAL_STEPS[:place], force_check.STEP, *CLINICAL_STEPS[place:])
    names = [str(key) for key in order_of(steps, ("T1",)).sequence]
    assert names.index("tool_change") < names.index("force_check") < names.index("positioning:T1")
    assert "tool_check --> force_check" in mermaid(steps)
