import pytest
from plain_steps import plain_order, plain_steps

from procedures.engine.machine import ProcedureMachine, mermaid, state_of
from procedures.engine.order import order_of
from procedures.steps.catalogue import CLINICAL_STEPS


@pytest.mark.parametrize("trajectories", [("T1",), ("T1", "T2", "T3")])
def test_the_sequence_of_a_case_leads_through_the_chart_to_its_end(trajectories: tuple[str, ...]) -> None:
    order = order_of(CLINICAL_STEPS, trajectories)
    machine = ProcedureMachine(order)
    for key in order.sequence:
        machine.begin(key.name)
        assert machine.state == state_of(order.spec(key))
    machine.finish()
    assert machine.state == "finished"


@pytest.mark.parametrize("step", CLINICAL_STEPS, ids=lambda step: step.name)
def test_every_step_is_drawn_in_its_phase(step) -> None:
    chart = mermaid(CLINICAL_STEPS)
    phase = chart[chart.index(f"state {step.phase} {{") :]
    assert f"    {step.name}\n" in phase[: phase.index("}")]


def test_what_is_repeated_for_each_trajectory_leads_back_in_the_chart() -> None:
    chart = mermaid(plain_steps())
    assert "fit --> localization : next trajectory" in chart
    assert "back --> approach : next trajectory" in chart


def test_a_failed_step_leads_to_fault_and_nothing_leads_out() -> None:
    machine = ProcedureMachine(plain_order())
    machine.begin("image")
    machine.fail()
    assert machine.state == "fault"
    assert machine.ended
