"""The stream of telegrams: plain UDP clients that know nothing of our driver."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from kuka_clients import Cell

from sim.theatre.world import World


def test_the_controller_speaks_first_on_a_constant_port_with_even_stamps(cell: Callable[..., Cell]) -> None:
    rsi = cell("--autostart").rsi
    first = rsi.receive()
    assert first.startswith(b'<Rob Type="KUKA"><RIst X="')
    assert first.endswith(b"</IPOC></Rob>")
    assert b"> <" not in first
    assert b" />" not in first
    source, stamp = rsi.source, rsi.ipoc
    for _ in range(250):
        rsi.answer()
        rsi.receive()
        stamp += 4
        assert (rsi.source, rsi.ipoc) == (source, stamp)
    assert rsi.late < 250  # a stalled machine loses many


def test_without_eki_the_stream_begins_again_after_a_command_that_the_arm_cannot_follow(
    cell: Callable[..., Cell],
) -> None:
    rsi = cell("--autostart").rsi
    rsi.cycles(10)
    first = rsi.source
    for _ in range(250):  # until the port of the next run; its first telegram comes after a pause
        rsi.receive()
        if rsi.source != first:
            break
        rsi.answer((50.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert rsi.source != first
    assert rsi.source[0] == "127.0.0.1"
    rsi.answer()
    rsi.cycles(50)


def test_a_late_reply_is_counted_and_does_not_delay_the_following_ones(cell: Callable[..., Cell]) -> None:
    rsi = cell("--autostart").rsi
    rsi.cycles(10)
    rsi.receive()
    stale = rsi.ipoc
    rsi.receive()
    rsi.answer(ipoc=stale)
    rsi.answer()
    rsi.receive()
    before = rsi.late
    assert before >= 1
    rsi.answer()
    rsi.cycles(200)
    assert rsi.late - before < 200  # a stalled machine loses many; one behind for good would be all


def test_stale_broken_and_doubled_datagrams_cost_no_cycle(
    cell: Callable[..., Cell], lock_step_world: World
) -> None:
    here = cell(world=lock_step_world)
    eki, rsi = here.project(), here.rsi
    here.start(eki)
    for n in range(200):
        rsi.receive()
        rsi.answer(ipoc=max(0, rsi.ipoc - 4))
        rsi.answer(ipoc=rsi.ipoc + 4)
        rsi.socket.sendto(b"<Sen Type='KROSHU'><IPOC>" + str(rsi.ipoc).encode(), rsi.source)
        rsi.socket.sendto(bytes(range(n)), rsi.source)
        rsi.answer()
        rsi.answer((50.0,) * 6)  # the second for the same cycle says nothing any more
    assert rsi.late == 0
    assert eki.state(Id="8").get("RSI") == "2"


def test_the_run_ends_on_stop_and_the_next_one_begins_elsewhere(
    cell: Callable[..., Cell], lock_step_world: World
) -> None:
    here = cell(world=lock_step_world)
    eki, rsi = here.project(), here.rsi
    here.start(eki)
    rsi.cycles(10)
    source, stamp = rsi.source, rsi.ipoc
    rsi.move((6.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    rsi.cycles(80, (6.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    reached = rsi.axes_deg[0]
    rsi.receive()
    rsi.answer((6.0, 0.0, 0.0, 0.0, 0.0, 0.0), stop=1)
    assert rsi.quiet(0.3)
    eki.state(RSI="0", ProState="P_END", Moving="0")
    here.start(eki)
    rsi.receive()
    assert rsi.source != source
    assert abs(rsi.ipoc - stamp) > 4 * 400
    assert reached == pytest.approx(6.0, abs=1e-4)
    assert rsi.axes_deg[0] == reached


def test_a_teleport_ends_the_run_and_waits_for_acknowledgement(
    cell: Callable[..., Cell], lock_step_world: World
) -> None:
    here = cell(world=lock_step_world)
    eki, rsi = here.project(), here.rsi
    here.start(eki)
    rsi.cycles(20)
    rsi.receive()
    rsi.answer((30.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert rsi.quiet(0.3)
    state = eki.state(RSI="3")
    assert (state.get("Err"), state.get("Drives"), state.get("Stopmess")) == ("1074", "0", "1")
    axes = state.find("Axis")
    assert axes is not None
    assert float(axes.get("A1", "")) == pytest.approx(rsi.axes_deg[0], abs=1e-4)
    assert eki.command("DRIVES", On=1) == 0
    assert eki.command("RSI_START") == 1
    assert eki.command("ACK_ERRORS") == 0
    here.start(eki)
    rsi.cycles(5)
