import pytest
from transitions import MachineError

from procedures.engine.machine import PHASES, ProcedureMachine, mermaid, state_of


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


def test_localizations_repeat_for_each_trajectory_and_none_comes_after_the_tool_change() -> None:
    machine = ProcedureMachine()
    for step in (
        "ct_import",
        "fiducial_localization",
        "plan_check",
        "set_up",
        "global_localization",
        "correspondence",
        "path_check",
        "relocalization",
        "registration",
        "relocalization",
        "registration",
        "tool_change",
    ):
        assert machine.begin(step, ())
    assert not machine.may_follow("relocalization")
    for step in ("positioning", "at_target", "retreat", "positioning", "at_target", "retreat"):
        assert machine.begin(step, ())
    machine.finish()
    assert machine.state == "finished"


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
