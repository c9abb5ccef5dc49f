from __future__ import annotations

import re
from contextlib import suppress
from functools import partial

import pytest
from plain_steps import plain_order, plain_steps
from transitions import MachineError

from procedures.engine.machine import BETWEEN, ENDS, RESTS, ProcedureMachine, state_chart_mermaid, state_of
from procedures.engine.order import CaseOrder, Steps, order_of
from procedures.steps.catalogue import CLINICAL_STEPS, clinical_steps


@pytest.mark.parametrize("trajectories", [("T1",), ("T1", "T2", "T3")])
def test_the_step_sequence_of_a_case_passes_through_the_chart_to_its_end(
    trajectories: tuple[str, ...],
) -> None:
    order = order_of(CLINICAL_STEPS, trajectories)
    machine = ProcedureMachine(order)
    for key in order.sequence:
        machine.begin(key.name)
        assert machine.state == state_of(order.spec(key))
    machine.finish()
    assert machine.state == "finished"


@pytest.mark.parametrize("step", CLINICAL_STEPS, ids=lambda step: step.name)
def test_every_step_is_drawn_in_its_phase(step) -> None:
    chart = state_chart_mermaid(CLINICAL_STEPS)
    phase = chart[chart.index(f"state {step.phase} {{") :]
    assert f"    {step.name}\n" in phase[: phase.index("}")]


def test_steps_repeated_for_each_trajectory_loop_back_in_the_chart() -> None:
    chart = state_chart_mermaid(plain_steps())
    assert "fit --> localization : next trajectory" in chart
    assert "back --> approach : next trajectory" in chart


def drawn(chart: str) -> set[tuple[str, str]]:
    """Arrows between states: a phase stands for its steps, a junction for whatever leads on from it."""
    steps = {
        phase: inside.split() for phase, inside in re.findall(r"state (\w+) \{(.*?)\}", chart, re.DOTALL)
    }
    arrows = [
        (one, other)
        for source, target in re.findall(r"^  (\w+) --> (\w+)", chart, re.MULTILINE)
        for one in steps.get(source, [source])
        for other in steps.get(target, [target])
    ]
    junctions = re.findall(r"state (\w+) <<choice>>", chart)
    through = {
        (one, other)
        for one, junction in arrows
        for before, other in arrows
        if junction == before and junction in junctions
    }
    return through | {way for way in arrows if not set(way) & set(junctions)}


def made(order: CaseOrder) -> set[tuple[str, str]]:
    """What the machine does in each of its states when it is told whatever it can be told."""
    states = [*BETWEEN, *ENDS, *map(state_of, order.steps)]
    machine = ProcedureMachine(order)
    asked = [machine.accept, machine.hold, machine.finish, machine.abort]
    asked += [partial(machine.begin, step.name) for step in order.steps]
    ways = set()
    for state in states:
        for ask in asked:
            machine.state = state
            with suppress(MachineError):
                ask()
                ways.add((state, machine.state))
        for rest in RESTS:
            machine.state = state
            with suppress(MachineError), machine.resting(rest):
                if machine.state != state:
                    ways |= {(state, machine.state), (machine.state, state)}
    return {(one.rpartition(".")[2], other.rpartition(".")[2]) for one, other in ways}


@pytest.mark.parametrize("steps", [CLINICAL_STEPS, clinical_steps(measure_targets=True), plain_steps()])
def test_the_chart_has_exactly_the_transitions_of_the_machine(steps: Steps) -> None:
    assert drawn(state_chart_mermaid(steps)) == made(order_of(steps, ("T1",)))


def test_a_held_case_continues_with_a_step() -> None:
    machine = ProcedureMachine(plain_order())
    machine.begin("image")
    machine.hold()
    assert (machine.state, machine.ended) == ("held", False)
    machine.begin("image")
    assert machine.state == "operation.image"


@pytest.mark.parametrize("rest", ["paused", "suspended"])
def test_a_pause_or_suspension_returns_to_the_former_state_however_it_ends(rest: str) -> None:
    machine = ProcedureMachine(plain_order())
    machine.begin("image")
    with machine.resting(rest):
        assert machine.state == rest
    with pytest.raises(KeyboardInterrupt), machine.resting(rest):
        raise KeyboardInterrupt
    assert machine.state == "operation.image"


@pytest.mark.parametrize("ended", [False, True])
def test_a_pause_on_the_way_home_lets_no_step_of_an_ended_or_unaccepted_case_begin(ended: bool) -> None:
    machine = ProcedureMachine(plain_order(), recovering=True)
    if ended:
        machine.abort()
    before = machine.state
    with machine.resting("paused"), pytest.raises(MachineError):
        machine.begin("image")
    assert machine.state == before


def test_no_step_starts_in_recovery_before_it_is_accepted() -> None:
    machine = ProcedureMachine(plain_order(), recovering=True)
    with pytest.raises(MachineError):
        machine.begin("image")
    machine.accept()
    assert machine.state == "held"


def test_an_aborted_case_has_ended() -> None:
    machine = ProcedureMachine(plain_order())
    machine.abort()
    assert machine.ended
    with pytest.raises(MachineError):
        machine.begin("image")
