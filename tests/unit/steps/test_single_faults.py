"""The table of single faults holds every fault of the catalogue, every step and every branch of a case."""

import re
from collections import Counter
from itertools import chain
from pathlib import Path

import pytest
from single_faults import (
    AS_IN,
    COMPUTED,
    CONNECTING,
    DONE,
    ELSEWHERE,
    FEWEST,
    ROWS,
    SCENES,
    SINCE,
    STEPS,
    cells,
    device_of,
    noticed_by_device,
    steps_of,
)

from procedures.steps import branches
from procedures.steps.branches import Branch
from procedures.steps.catalogue import CLINICAL_STEPS, clinical_steps
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.roles import ONE_ARM, TWO_ARMS
from sim.world.faults import DEVICES, FAULT_KINDS, check_faults, parse_faults
from sim.world.scene.assistant import add_assistant
from sim.world.scene.named_scenes import draw_scene

ORDER = [step.name for step in CLINICAL_STEPS]
BRANCHES = {name: row for name, row in vars(branches).items() if isinstance(row, Branch)}
CODES = set(
    re.findall(
        r"^\| ([A-Z]+-\d{3}) ",
        (Path(__file__).parents[3] / "docs/reference/error-codes.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
)
DEVICE_ROWS = [row for row in ROWS if device_of(row) in STEPS]


def test_every_fault_of_the_catalogue_is_in_the_table() -> None:
    rows = [row for row in ROWS if row.fault and (not row.arms or row.fault.startswith("room"))]
    held = {parse_faults(f"now: {row.fault}")[0].kind.usage for row in rows}
    assert held == {kind.usage for kind in FAULT_KINDS if kind.device in DEVICES}


@pytest.mark.parametrize("device", STEPS)
def test_every_step_of_a_case_is_accounted_for_with_each_device(device: str) -> None:
    assert sorted((*STEPS[device], *COMPUTED, *AS_IN[device])) == sorted(ORDER)
    assert set(AS_IN[device].values()) <= set(STEPS[device])


def test_every_row_can_be_run() -> None:
    for row in ROWS:
        assert set(steps_of(row)) <= {
            step.name for step in clinical_steps(roles=TWO_ARMS if row.arms else ONE_ARM)
        }, row
        assert not row.after_s or row.begins == SINCE, row
        assert bool(row.fault) != bool(row.scene or row.answers), row
        assert not row.scene or row.scene in SCENES, row
        if row.fault:
            scene = draw_scene("mini", seed=3, markers=row.markers)
            if row.arms:
                scene = add_assistant(scene, ArmChoice(row.arms[-1]) if row.arms[1:] else ArmChoice.KR6)
            check_faults(parse_faults(f"now: {row.fault}"), scene)


def test_every_stop_has_a_code_and_a_promised_time() -> None:
    for row in ROWS:
        codes = set(row.ends.split()) - {DONE}
        assert codes <= CODES, row
        by_device = {code for code in codes if noticed_by_device([code])}
        assert not by_device or row.host_s is not None, row
        assert codes == by_device or row.theatre_s is not None, row


def test_a_row_that_names_a_branch_ends_as_the_branch_says() -> None:
    for row in ROWS:
        if row.branch and (codes := {error.code for error in BRANCHES[row.branch].errors}):
            topic = BRANCHES[row.branch].topic
            assert codes & set(row.ends.split()) or (topic is not None and row.asks == topic), row


def test_every_branch_is_reached_or_says_what_it_would_take() -> None:
    reached = {row.branch for row in ROWS} - {""}
    assert reached | set(ELSEWHERE) == set(BRANCHES)
    assert reached.isdisjoint(ELSEWHERE)


def test_no_cell_is_in_the_matrix_twice_and_there_are_three_hundred() -> None:
    assert max(Counter(cell.name for cell in cells()).values()) == 1
    assert len(cells()) >= 300


def test_a_fault_of_a_device_begins_in_every_step_that_uses_it_or_only_while_it_connects() -> None:
    for fault in {row.fault for row in DEVICE_ROWS}:
        rows = [row for row in DEVICE_ROWS if row.fault == fault and row.markers == FEWEST]
        begun = sorted(chain.from_iterable(map(steps_of, rows)))
        assert begun in (sorted(STEPS[device_of(rows[0])]), [CONNECTING]), fault
