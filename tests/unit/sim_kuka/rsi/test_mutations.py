"""Mutated replies through the simulator's controller: no foreign one is taken, and the arm does not jump."""

from __future__ import annotations

from typing import Any

import pytest
from mutations import mutations

FEW, MANY = 3000, 1_000_000
AWAY = (
    b'<Sen Type="%s"><Stop>1</Stop><AK A1="0.100000" A2="-0.1" A3="0.1" A4="0.1" A5="0.1" A6="0.1"/>'
    b"<IPOC>%d</IPOC></Sen>"
)


def test_no_mutant_of_a_foreign_reply_is_taken(bench: Any) -> None:
    """The cycle or the type is another one; a mutation of a few bytes does not mend that."""
    bench.enter_movecorr()
    run = bench.controller.run
    foreign = (AWAY % (b"KROSHU", run.ipoc - 400), AWAY % (b"ImFree", run.ipoc))
    assert [mutant for mutant in mutations(foreign, FEW, seed=3) if run.read(mutant) is not None] == []
    assert run.read(AWAY % (b"KROSHU", run.ipoc)) is not None


def test_mutated_replies_never_make_a_resting_arm_jump(bench: Any) -> None:
    _nothing_moves(bench, FEW)


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_a_million_mutated_replies_never_make_a_resting_arm_jump(bench: Any) -> None:
    _nothing_moves(bench, MANY)


def _nothing_moves(bench: Any, count: int) -> None:
    """Mutants of replies that hold the arm still: what is taken moves it no further than a digit can."""
    bench.enter_movecorr()
    controller = bench.controller
    template = (
        '<Sen Type="KROSHU"><Stop>0</Stop><AK A1="0.000000" A2="0.000000" A3="0.000000" A4="0.000000"'
        ' A5="0.000000" A6="0.000000"/><IPOC>%d</IPOC></Sen>'
    )
    steps = mutations((template.encode(),), count, seed=23)
    for mutant in steps:
        run = controller.run
        if run is None:
            # A changed digit or a raised Stop may end the run; it never makes the arm jump.
            while controller.moving:
                controller.settle()
            controller.acknowledge()
            controller.switch_drives(True)
            assert controller.start().code == 0
            bench.enter_movecorr()
            continue
        before = controller.arm.axes_deg
        controller.finish_cycle(run.read(mutant.replace(b"%d", b"%d" % run.ipoc)))
        after = controller.arm.axes_deg
        for joint, a, b in zip(controller.arm.description.joints, before, after, strict=True):
            assert abs(b - a) <= 0.25 * joint.full_speed_deg_s * 0.004 + 1e-6
        if controller.run is run:
            bench.answer()
