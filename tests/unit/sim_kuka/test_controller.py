"""The controller: programs, drives, motions and trips, its EKI requests and the addresses of its sockets."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Any

import pytest
from coded_errors import raises
from shared_controller import Make, on_a1

from ronna_hw.endpoints import parse_endpoint
from ronna_hw.wire.kuka_eki import AckCode, OperationMode, ProState, RsiState
from sim.errors import BadFaultScript
from sim.kuka.autostart import Autostart
from sim.kuka.controller_parameters import AUTOSTART_PAUSE_S, ControllerParameters
from sim.kuka.eki.server import split_requests
from sim.kuka.errors import CLIENT_ADDRESS_INVALID
from sim.kuka.pendant import TRIPS as MESSAGES
from sim.kuka.rsi.link import RsiSocket, resolve
from sim.world.faults import FaultBoard, check_faults, parse_faults
from sim.world.faults.robot import TRIPS
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

GOAL = (4.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_start_needs_drives_on_the_key_in_ext_and_an_idle_program(make_bench: Make) -> None:
    controller = make_bench(start=False).controller
    assert controller.start().code is AckCode.NOT_READY
    controller.turn_key(OperationMode.T1)
    controller.switch_drives(True)
    assert controller.start().code is AckCode.REFUSED
    controller.turn_key(OperationMode.EXT)
    controller.press_emergency_stop(True)
    assert controller.start().code is AckCode.NOT_READY
    assert controller.switch_drives(True).code is AckCode.NOT_READY
    assert controller.acknowledge().code is AckCode.NOT_READY
    controller.press_emergency_stop(False)
    controller.switch_drives(True)
    assert controller.start().code is AckCode.REFUSED  # the message stands until it is acknowledged
    assert controller.acknowledge().code is AckCode.OK
    controller.open_guard(True)
    assert controller.start().code is AckCode.NOT_READY
    assert controller.acknowledge().code is AckCode.NOT_READY
    controller.open_guard(False)
    assert controller.acknowledge().code is AckCode.OK
    assert controller.switch_drives(True).code is AckCode.OK
    controller.turn_key(OperationMode.AUT)
    controller.switch_drives(True)
    assert controller.start().code is AckCode.REFUSED
    controller.turn_key(OperationMode.EXT)
    assert controller.start().code is AckCode.NOT_READY  # turning the key switches the drives off
    controller.switch_drives(True)
    assert controller.start(correction="POS").code is AckCode.BAD_VALUE
    assert controller.start(correction="AXIS").code is AckCode.OK
    assert controller.start().code is AckCode.BUSY
    assert controller.select().code is AckCode.REFUSED


@pytest.mark.parametrize("reason", ["stop", "drives", "emergency", "guard", "key"])
@pytest.mark.parametrize("streams", [True, False])
def test_every_interruption_brakes_the_arm_and_later_corrections_have_no_effect(
    make_bench: Make, reason: str, streams: bool
) -> None:
    bench = make_bench(parameters=ControllerParameters(streams_after_stop=streams))
    controller = bench.controller
    bench.enter_movecorr()
    bench.ramp(GOAL, steps=100)
    interrupt: dict[str, Callable[[], object]] = {
        "stop": controller.stop,
        "drives": lambda: controller.switch_drives(False),
        "emergency": lambda: controller.press_emergency_stop(True),
        "guard": lambda: controller.open_guard(True),
        "key": lambda: controller.turn_key(OperationMode.T1),
    }
    interrupt[reason]()
    assert controller.program_state is ProState.STOP
    assert (controller.run is not None) is streams
    if streams:
        assert controller.rsi_state is RsiState.ON
        for n in range(300):
            bench.answer((4.0 + 0.04 * n, 0.0, 0.0, 0.0, 0.0, 0.0))
    else:
        while controller.moving:
            controller.settle()
    assert not controller.moving
    assert 3.0 < controller.arm.axes_deg[0] < 5.0
    assert controller.drives_on is (reason == "stop")
    assert (controller.message is not None) is (reason in ("emergency", "guard"))
    if streams:
        controller.cancel()
        assert controller.program_state is ProState.FREE


def test_only_an_acknowledgement_clears_a_fault(bench: Any) -> None:
    bench.enter_movecorr()
    bench.answer((50.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    controller = bench.controller
    assert controller.rsi_state is RsiState.FAULT
    assert controller.cancel().code is AckCode.REFUSED
    controller.switch_drives(True)
    assert controller.start().code is AckCode.REFUSED
    controller.acknowledge()
    assert controller.rsi_state is RsiState.IDLE
    assert controller.start().code is AckCode.OK


def test_set_tool_is_refused_during_a_run_and_tool_base_and_override_apply_outside_it(bench: Any) -> None:
    controller = bench.controller
    frame = (10.0, 0.0, 100.0, 0.0, 0.0, 0.0)
    assert controller.set_tool(2, frame).code is AckCode.REFUSED
    controller.cancel()
    flange = list(controller.arm.frame)
    assert controller.set_tool(2, frame).code is AckCode.OK
    assert controller.arm.frame[2] == pytest.approx(flange[2] - 100.0)
    assert controller.set_base(3, (0.0, 0.0, 500.0, 90.0, 0.0, 0.0)).code is AckCode.OK
    assert controller.arm.frame[2] == pytest.approx(flange[2] - 600.0)
    assert controller.arm.frame[1] == pytest.approx(-(flange[0] - 10.0))
    assert controller.set_override(0).code is AckCode.BAD_VALUE
    assert controller.set_override(30).code is AckCode.OK


def test_autostart_waits_for_its_client_and_restarts_after_a_lost_client_or_a_fault(make_bench: Make) -> None:
    bench = make_bench(start=False)
    controller = bench.controller
    autostart = Autostart(controller, is_requested=True)
    autostart.begin()
    bench.miss(500)  # nobody is there yet
    assert controller.run.late == 0
    bench.answer()
    bench.miss(100)
    assert controller.run is None
    autostart.tick(10.0)
    assert controller.run is None
    autostart.tick(10.0 + AUTOSTART_PAUSE_S)
    assert controller.run is not None
    bench.enter_movecorr()
    bench.answer((50.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert controller.message is not None
    while controller.moving:
        controller.settle()
    autostart.tick(20.0)
    assert controller.run is None
    autostart.tick(20.0 + AUTOSTART_PAUSE_S)
    assert controller.run is not None  # a fault of the arm too is over after the pause
    assert controller.message is None


def test_autostart_restarts_after_an_emergency_stop_is_released(make_bench: Make) -> None:
    bench = make_bench(start=False)
    controller = bench.controller
    autostart = Autostart(controller, is_requested=True)
    autostart.begin()
    bench.enter_movecorr()
    controller.press_emergency_stop(True)
    stopped = controller.run
    for now_s in (10.0, 10.0 + AUTOSTART_PAUSE_S):
        autostart.tick(now_s)
    assert controller.run is stopped  # it is still pressed
    controller.press_emergency_stop(False)
    for now_s in (20.0, 20.0 + AUTOSTART_PAUSE_S):
        autostart.tick(now_s)
    assert controller.run is not stopped
    bench.enter_movecorr()
    assert controller.rsi_state is RsiState.MOVECORR


def test_requests_are_extracted_from_padding_fragments_and_merged_reads() -> None:
    one = b'<External REQTYPE="0" CycleTime="0" ControlMode="0"></External>'
    two = b'<Cmd Id="1" Name="STATUS"/>'
    nested = b'<Cmd Id=">"><A b="/Cmd>"/><A>x</A></Cmd>'
    stream = b"\0\0garbage > " + one + b"\n" + b"\0" * 430 + two + nested + b"\0"
    assert split_requests(stream) == ([one, two, nested], b"")
    for cut in range(len(stream)):
        first, rest = split_requests(stream[:cut])
        second, left = split_requests(rest + stream[cut:])
        assert first + second == [one, two, nested]
        assert left == b""


def test_an_unresolvable_client_address_has_its_own_error() -> None:
    with raises(CLIENT_ADDRESS_INVALID) as caught:
        resolve(parse_endpoint("udp://ip.address.of.rospc:59152"))
    assert caught.value.code == "KRC-002"


def test_a_reply_from_another_host_than_the_client_is_none() -> None:
    rsi = RsiSocket(("127.0.0.1", 59152))
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind(("127.0.0.2", 0))
            for receive in (rsi.receive, rsi.wait_for_datagram):
                stranger.sendto(b"<Sen/>", rsi.socket.getsockname())
                assert receive() == b""
    finally:
        rsi.close()


@pytest.mark.parametrize(("host", "source"), [("127.0.0.1", "127.0.0.1"), ("127.0.0.2", "127.0.0.1")])
def test_a_client_on_this_host_is_served_from_loopback_only(host: str, source: str) -> None:
    rsi = RsiSocket((host, 59152))
    try:
        assert rsi.socket.getsockname()[0] == source
    finally:
        rsi.close()


NUMBERS = {
    "timeout": 29002,
    "rsi_bad": 29002,
    "monitor": 29000,
    "torque": 1073,
    "acceleration": 1074,
    "velocity": 1102,
    "overspeed": 421,
    "end_switch": ControllerParameters().end_switch_message,
    "singularity": 1102,
}
ON_ITS_PATH = {"timeout", "rsi_bad", "monitor", "end_switch"}  # the arm brakes with its drives on


def test_a_script_can_name_every_existing_message_and_no_other() -> None:
    assert set(TRIPS) == set(MESSAGES) == set(NUMBERS)
    with pytest.raises(BadFaultScript, match=r"expected trip timeout, .*, got tea"):
        check_faults(parse_faults("now: robot trip tea"), draw_scene("mini"))


@pytest.mark.parametrize("name", TRIPS)
def test_a_trip_ends_the_run_in_a_braked_stop_with_its_message(bench: Any, name: str) -> None:
    controller = bench.controller
    bench.enter_movecorr()
    bench.ramp(on_a1(4.0), steps=100)
    before = controller.arm.axes_deg[0]
    controller.trip(name)
    assert controller.message.number == NUMBERS[name]
    assert (controller.run, controller.rsi_state) == (None, RsiState.FAULT)
    assert controller.drives_on is (name in ON_ITS_PATH)
    while controller.moving:
        controller.settle()
    assert before < controller.arm.axes_deg[0] < before + 1.0
    assert controller.start().code is AckCode.REFUSED
    assert controller.acknowledge().code is AckCode.OK


def test_a_trip_of_an_idle_controller_raises_no_message(make_bench: Make) -> None:
    controller = make_bench(start=False).controller
    controller.trip("velocity")
    assert controller.message is None


def test_narrowed_limits_clamp_corrections_from_the_current_position_and_stat_shows_it(bench: Any) -> None:
    controller = bench.controller
    bench.enter_movecorr()
    bench.go(on_a1(4.0))
    for _ in range(3):
        controller.narrow_corrections(0.5)  # a lasting fault says it in every cycle
    bench.go(on_a1(6.0), from_deg=on_a1(4.0))
    assert controller.arm.axes_deg[0] == 4.5
    assert controller.run.correction_stats == (0b11, 0)
    bench.go(on_a1(4.2), from_deg=on_a1(6.0))
    assert (controller.arm.axes_deg[0], controller.run.correction_stats) == (4.2, (0b1, 0))
    controller.narrow_corrections(None)
    bench.go(on_a1(6.0), from_deg=on_a1(4.2))
    assert (controller.arm.axes_deg[0], controller.message) == (6.0, None)


def test_a_fault_set_for_a_cycle_begins_with_that_telegram_and_lasts_in_theatre_time() -> None:
    world = World.create(draw_scene("mini"), paced=False)
    seen: list[tuple[bool, int]] = []
    board = FaultBoard(world, "robot", lambda: len(seen) + 1)
    world.set_fault_script("at cycle 3: robot drop 7 % for 0.007 s\nat cycle 4: robot collision")
    for _ in range(7):
        seen.append((bool(board.active("drop")), len(board.happened("collision"))))
        world.clock.sleep(0.004)
    assert seen == [(False, 0), (False, 0), (True, 0), (True, 1), (False, 0), (False, 0), (False, 0)]
    world.clock.close()
