import pytest
from transitions import MachineError

from procedures.engine.machine import ProcedureMachine, mermaid, state_of
from procedures.engine.order import PHASES, sequence_of


def test_steps_follow_each_other_only_in_the_order_of_the_chart() -> None:
    machine = ProcedureMachine()
    assert machine.may_follow("ct_import")
    assert not machine.may_follow("positioning")
    with pytest.raises(MachineError):
        machine.begin("positioning", ())


def test_a_step_with_unmet_preconditions_is_not_entered() -> None:
    machine = ProcedureMachine()
    assert not machine.begin("ct_import", ("no series",))
    assert machine.state == "idle"


@pytest.mark.parametrize("trajectories", [("T1",), ("T1", "T2", "T3")])
def test_the_sequence_of_a_case_leads_through_the_chart_to_its_end(trajectories: tuple[str, ...]) -> None:
    machine = ProcedureMachine()
    for key in sequence_of(trajectories):
        assert machine.begin(key.name, ())
    machine.finish()
    assert machine.state == "finished"


def test_every_trajectory_is_registered_before_the_tool_change_and_none_after_it() -> None:
    names = [str(key) for key in sequence_of(("T1", "T2"))]
    exchanged = names.index("tool_change")
    assert max(names.index("registration:T1"), names.index("registration:T2")) < exchanged
    assert exchanged < min(names.index("positioning:T1"), names.index("positioning:T2"))
    machine = ProcedureMachine()
    for key in sequence_of(("T1", "T2"))[: exchanged + 1]:
        machine.begin(key.name, ())
    assert not machine.may_follow("relocalization")


@pytest.mark.parametrize("step", [step for steps in PHASES.values() for step in steps])
def test_every_step_is_drawn_in_the_chart(step: str) -> None:
    assert f"    {step}\n" in mermaid()
    assert state_of(step).endswith(step)


def test_a_failed_step_leads_to_fault_and_nothing_leads_out() -> None:
    machine = ProcedureMachine()
    machine.begin("ct_import", ())
    machine.fail()
    assert machine.state == "fault"
    assert not machine.may_follow("fiducial_localization")
