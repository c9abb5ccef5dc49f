"""Mutated telegrams through the simulator's codecs: no exception is raised and no value is invented."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import pytest
from mutations import mutations

from ronna_hw.wire.kuka_context import load_context
from sim.kuka.eki.server import cut_requests
from sim.kuka.rsi.reply_reader import ReplyReader

FEW, MANY = 20_000, 1_000_000
REPLIES = (
    b'<Sen Type="KROSHU"><Stop>0</Stop><AK A1="1.500000" A2="-2" A3="0.0" A4="0.0" A5="0.0" A6="0.25"/>'
    b"<IPOC>4208163634</IPOC></Sen>",
    b"<Sen Type='KROSHU'>\n <IPOC>44</IPOC><AK A6='1e-3' A1='.5'></AK><EStr>a &lt; b</EStr>"
    b"<Stop> 0 </Stop></Sen>\n",
)
REQUESTS = (
    b'<Cmd Id="1" Name="STATUS"></Cmd>',
    b'<Cmd Id="2" Name="PTP_AXIS" A1="1" A2="-90" A3="90" A4="0" A5="0" A6="0" Vel="10"/>',
    b'<External REQTYPE="0" CycleTime="1" ControlMode="1"></External>\n' + bytes(40),
)


@pytest.fixture
def read() -> Callable[[bytes], Any]:
    context = load_context()
    return ReplyReader(context.receive, context.ethernet.sentype).read


def _replies_survive(read: Callable[[bytes], Any], count: int) -> None:
    taken = 0
    for data in mutations(REPLIES, count, seed=11):
        reply = read(data)
        if reply is not None:
            taken += 1
            assert all(value is None or -1e300 < value < 1e300 for value in reply.values)
            assert 0 <= reply.ipoc < 10**20
            assert b"KROSHU" in data
            assert b"IPOC" in data
    assert 0 < taken < 0.6 * count


def test_mutated_replies_never_raise_and_never_invent_numbers(read: Callable[[bytes], Any]) -> None:
    _replies_survive(read, FEW)


def test_mutated_requests_raise_nothing_but_parse_errors() -> None:
    rest = b""
    for data in mutations(REQUESTS, FEW // 4, seed=5):
        requests, rest = cut_requests(rest[-2000:] + data)
        for request in requests:
            try:
                ElementTree.fromstring(request)
            except ElementTree.ParseError:
                continue


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_a_million_mutated_replies_never_raise_and_never_invent_numbers(
    read: Callable[[bytes], Any],
) -> None:
    _replies_survive(read, MANY)


def test_mutated_replies_never_make_a_resting_arm_jump(bench: Any) -> None:
    _nothing_moves(bench, 3000)


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
