"""The disturbance table is consistent: its tests exist and check its codes, and no fault is missing."""

from __future__ import annotations

import reference_tables
from generate import list_errors_with_code

from sim.world.faults.robot import ROBOT_FAULTS

# A driver in automatic mode meets nothing of these, or what it meets stands in another line.
OTHER_FAULTS = {
    "short_first": "old RSI only; a telegram of another form",
    "enabling_switch": "T1 and T2",
    "start_key": "T1 and T2",
    "stick": "the arm's own, seen in its accuracy",
    "sensor_dead": "of the assistant, seen by its drill",
}


def test_every_test_named_in_the_table_exists_exactly_once() -> None:
    files = reference_tables.files_of_tests()
    named = {name for one in reference_tables.read_disturbances() for name in one.tests}
    assert {name: files.get(name, ()) for name in named if len(files.get(name, ())) != 1} == {}


def test_every_promise_has_a_test_and_each_code_appears_in_one_of_them() -> None:
    files = reference_tables.files_of_tests()
    names = {
        error.code: error.name
        for error in list_errors_with_code()
        if error.module == "drivers.kuka_rsi.errors"
    }
    for one in reference_tables.read_disturbances():
        assert one.tests, one.disturbance
        text = "".join(path.read_text(encoding="utf-8") for name in one.tests for path in files[name])
        for code in one.codes:
            assert code in text or names[code] in text, f"{one.disturbance}: {code}"


def test_every_robot_fault_has_a_promise() -> None:
    promised = {fault for one in reference_tables.read_disturbances() for fault in one.faults}
    assert promised | set(OTHER_FAULTS) == {kind.name for kind in ROBOT_FAULTS}
    assert not promised & set(OTHER_FAULTS)
