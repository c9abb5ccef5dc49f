"""The robot controller as a process: plain UDP and TCP clients that know nothing of our driver."""

from __future__ import annotations

import os
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from kuka_clients import FREE, LIMIT_S, Cell

from ronna_hw.child_process import command
from ronna_hw.wire.kuka_context import context_hash, load_context
from sim.theatre.built_in import built_in_scene
from sim.theatre.world import World


@pytest.fixture
def cell() -> Iterator[Callable[..., Cell]]:
    with ExitStack() as stack:
        yield lambda *options, world=None: Cell(stack, *options, world=world)


@pytest.fixture
def lock_step_world() -> Iterator[World]:
    world = World.create(built_in_scene("mini", seed=5), paced=False)
    yield world
    world.clock.close()


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


def test_the_state_says_what_a_driver_must_know_before_it_moves(cell: Callable[..., Cell]) -> None:
    eki = cell().project()
    state = eki.state(Id="8")
    expected = {
        "Mode": "EXT",
        "Drives": "0",
        "ProState": "P_FREE",
        "RSI": "0",
        "Tool": "1",
        "Ref": "ABS",
        "HoldOn": "1",
        "Cycle": "4",
        "CtxHash": context_hash(load_context()),
        "Variant": "kr6_r900_sixx",
    }
    assert {key: state.get(key) for key in expected} == expected
    assert [child.tag for child in state] == ["Axis", "Pos"]
    assert eki.command("RSI_START") == 5
    assert eki.command("DRIVES", On=2) == 2
    assert eki.command("RSI_START", Cycle=5) == 2
    assert eki.command("RSI_START", Ref="OTHER") == 2
    assert eki.command("PTP_AXIS", A1=0) == 2
    assert eki.command("NONSENSE") == 2
    assert eki.command("SELECT") == 0
    assert eki.command("CANCEL") == 0
    assert eki.command("SET_OV", Val=50) == 0
    assert eki.state(Ov="50") is not None
    assert not any(b"/>" in segment for segment in eki.segments)


def test_the_state_comes_unasked_and_requests_may_be_split_merged_and_padded(
    cell: Callable[..., Cell],
) -> None:
    eki = cell().project()
    for _ in range(5):
        assert eki.read().get("Id") == "0"
    request = b'<Cmd Id="9" Name="STATUS"></Cmd>'
    eki.socket.sendall(b"\0\0\n" + request[:11])
    eki.socket.sendall(request[11:] + b"\0" * 400 + request.replace(b"9", b"10") + request[:5])
    eki.until(lambda element: element.get("Id") == "9")
    eki.until(lambda element: element.get("Id") == "10")
    eki.socket.sendall(request[5:].replace(b"9", b"11"))
    eki.until(lambda element: element.get("Id") == "11")


@pytest.mark.hazard(34)
def test_a_second_client_is_refused_and_a_lost_one_does_not_end_the_run(cell: Callable[..., Cell]) -> None:
    here = cell()
    eki, rsi = here.project(), here.rsi
    here.start(eki)
    rsi.cycles(5)
    second = here.project()
    with pytest.raises(ConnectionError):
        second.read()
    # A client that is killed: no orderly end of the connection.
    eki.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    eki.close()
    rsi.cycles(50)
    again = here.project()
    assert again.state(Id="8").get("RSI") == "2"
    assert again.command("RSI_STOP") == 0
    assert rsi.quiet(0.2)


def test_garbage_without_end_closes_the_channel_but_not_the_controller(cell: Callable[..., Cell]) -> None:
    here = cell()
    eki = here.project()
    eki.socket.sendall(b"<Cmd " + b"x" * 40_000)
    with pytest.raises(ConnectionError):
        eki.until(lambda element: False)
    assert here.project().command("DRIVES", On=1) == 0


def request(number: int, cycle: int = 0, mode: int = 0) -> bytes:
    """As the maker's client writes it: text, line feed, and NUL up to 500 bytes."""
    text = f'<External REQTYPE="{number}" CycleTime="{cycle}" ControlMode="{mode}"></External>\n'
    return text.encode().ljust(500, b"\0")


def test_the_sdk_channel_follows_its_states_one_telegram_per_write(cell: Callable[..., Cell]) -> None:
    here = cell()
    eki = here.sdk()

    def ask(number: int, cycle: int = 0, mode: int = 0) -> tuple[int, str]:
        eki.socket.sendall(request(number, cycle, mode))
        response = eki.until(lambda element: element.find("Response") is not None).find("Response")
        assert response is not None
        return int(response.get("EventID", "")), response.text or ""

    eki.socket.sendall(request(0))
    answer = eki.read()
    init, response = answer.find("Init"), answer.find("Response")
    assert response is not None
    assert response.attrib == {"EventID": "5"}
    assert init is not None
    assert list(init.attrib) == ["VER", "NumAxes", "NumExternalAxes", "Model", "RobVer"]
    assert (init.get("VER"), init.get("NumAxes")) == ("1.0.0", "6")
    status = eki.read().find("Status")
    assert status is not None
    assert list(status.attrib) == [
        "ControlMode",
        "CycleTime",
        "DrivesPowered",
        "EmergencyStop",
        "GuardStop",
        "InMotion",
        "MotionPossible",
        "OperationMode",
        "RobotStopped",
    ]
    assert list(status.attrib.values()) == ["0", "2", "0", "0", "0", "0", "0", "4", "0"]
    assert ask(1)[0] == 7  # start before a control mode is chosen
    assert ask(6)[0] == 9
    assert ask(6)[0] == 9
    assert ask(8, cycle=3)[0] == 4
    assert ask(8, cycle=1)[0] == 11
    assert ask(4, mode=0)[0] == 4
    assert ask(4, mode=5) == (6, "CARTESIAN_POSITION_CONTROL")
    assert ask(1)[0] == 4  # no program is mapped to it
    assert ask(4, mode=1) == (6, "JOINT_POSITION_CONTROL")
    assert ask(1) == (0, " ")
    here.rsi.cycles(10)
    assert ask(0)[0] == 7
    assert ask(3)[0] == 2
    assert here.rsi.quiet(0.2)
    stream = b"".join(eki.segments)
    assert re.fullmatch(rb'(<Robot>(<\w+( \w+="[^"<>]*")*>[^<>]*</\w+>)+</Robot>)+', stream)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_within_two_seconds_of_a_signal_while_it_streams(
    cell: Callable[..., Cell], number: signal.Signals
) -> None:
    here = cell("--autostart")
    here.rsi.cycles(5)
    here.child.process.send_signal(number)
    assert here.child.process.wait(2.0) == 0


def test_it_ends_within_two_seconds_of_its_parents_death() -> None:
    script = (
        "import subprocess, sys; p = subprocess.Popen([sys.executable, '-P', '-m', 'sim.cli', 'kuka',"
        f" '--eki', '{FREE}', '--eki-project', '{FREE}', '--scene', 'mini'], stdout=subprocess.PIPE);"
        " p.stdout.readline(); print(p.pid, flush=True)"
    )
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True, timeout=20)
    watched = os.pidfd_open(int(done.stdout)) if os.path.exists(f"/proc/{int(done.stdout)}") else None
    if watched is not None:
        assert select.select([watched], [], [], 2.0)[0]
        os.close(watched)


def test_a_port_in_use_is_one_line_and_its_exit_code() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        done = subprocess.run(
            command("sim.cli", "kuka", "--eki", FREE, "--eki-project", endpoint),
            capture_output=True,
            text=True,
            timeout=20,
        )
    assert done.returncode == 4
    assert done.stderr.startswith("SIM-004")
    assert len(done.stderr.splitlines()) == 1


def test_lock_step_counts_cycles_and_not_host_time(cell: Callable[..., Cell], lock_step_world: World) -> None:
    here = cell(world=lock_step_world)
    eki, rsi = here.project(), here.rsi
    here.start(eki)
    rsi.cycles(5)
    before_s = lock_step_world.clock.now_s()
    rsi.move((5.0, 0.0, 0.0, 0.0, 0.0, 0.0), cycles=1000)
    passed_s = lock_step_world.clock.now_s() - before_s
    assert passed_s == pytest.approx(4.0, abs=0.009)
    assert rsi.late == 0
    # A reply that takes the host longer than many cycles is awaited and not late.
    rsi.receive()
    time.sleep(0.05)
    rsi.answer((5.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    rsi.cycles(3, (5.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert rsi.late == 0


def test_lock_step_waits_for_a_silent_client_and_then_lets_the_cycles_run_to_the_timeout(
    cell: Callable[..., Cell], lock_step_world: World
) -> None:
    here = cell(world=lock_step_world)
    eki, rsi = here.project(), here.rsi
    here.start(eki)
    rsi.cycles(10)
    before_s, began_s = lock_step_world.clock.now_s(), time.monotonic()
    state = eki.until(lambda element: element.get("RSI") == "3")
    assert state.get("Err") == "29002"
    assert time.monotonic() - began_s >= 2.0
    assert lock_step_world.clock.now_s() - before_s == pytest.approx(0.4, abs=0.02)


def test_a_client_may_come_back_at_once(cell: Callable[..., Cell]) -> None:
    here = cell()
    for _ in range(20):
        eki = here.project()
        assert eki.command("STATUS_PLEASE") == 2
        eki.close()


def test_dropped_replies_are_cycles_that_are_late(cell: Callable[..., Cell], lock_step_world: World) -> None:
    here = cell(world=lock_step_world)
    eki, rsi = here.project(), here.rsi
    lock_step_world.set_fault_script("at 0 s: robot drop 10 % for 4 s")
    here.start(eki)
    rsi.move((5.0, 0.0, 0.0, 0.0, 0.0, 0.0), cycles=900)
    lost = rsi.late
    assert 50 <= lost <= 140
    lock_step_world.set_fault_script("")
    rsi.cycles(300, (5.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert rsi.late - lost <= 1
    assert rsi.axes_deg[0] == pytest.approx(5.0, abs=1e-4)


def test_an_idle_world_paces_itself_until_somebody_waits(
    cell: Callable[..., Cell], lock_step_world: World
) -> None:
    here = cell(world=lock_step_world)
    eki, rsi = here.project(), here.rsi
    here.start(eki)
    rsi.cycles(60)
    began_s = time.monotonic()
    rsi.cycles(50)
    assert time.monotonic() - began_s >= 49 * 0.004
    assert lock_step_world.clock.streaming()
    assert eki.command("RSI_STOP") == 0
    deadline = time.monotonic() + LIMIT_S
    while lock_step_world.clock.streaming() and time.monotonic() < deadline:
        eki.state(RSI="0", Moving="0")
    assert not lock_step_world.clock.streaming()


def test_the_true_pose_after_a_motion_is_the_same_bit_for_bit(cell: Callable[..., Cell]) -> None:
    goal = (5.0, -4.0, 3.0, 2.0, 1.0, 8.0)
    found = []
    for idle in (3, 90):
        world = World.create(built_in_scene("mini", seed=5), paced=False)
        here = cell(world=world)
        eki, rsi = here.project(), here.rsi
        here.start(eki)
        rsi.cycles(idle)
        rsi.move(goal, cycles=400)
        while not world.arm().at_rest:
            rsi.cycles(5, goal)
        found.append(world.arm())
        here.child.stop()
        world.clock.close()
    assert found[0].motion_number == found[1].motion_number == 1
    assert found[0].joints_rad == found[1].joints_rad
    assert (found[0].robot_from_flange == found[1].robot_from_flange).all()


def test_a_motion_by_eki_is_answered_twice_and_takes_theatre_time(
    cell: Callable[..., Cell], lock_step_world: World
) -> None:
    eki = cell(world=lock_step_world).project()
    assert eki.command("DRIVES", On=1) == 0
    axes = eki.state(Id="8").find("Axis")
    assert axes is not None
    here = {name: float(value) for name, value in axes.attrib.items()}
    before_s = lock_step_world.clock.now_s()
    eki.socket.sendall(_ptp(21, {**here, "A1": here["A1"] + 20.0}, 10))
    answers = [eki.until(lambda element: element.get("Id") == "21").attrib for _ in range(2)]
    assert [(a["Cmd"], a["Code"], a["Text"]) for a in answers] == [
        ("PTP_AXIS", "0", "accepted"),
        ("PTP_AXIS", "0", ""),
    ]
    moved = eki.state(Moving="0", ProState="P_END").find("Axis")
    assert moved is not None
    assert float(moved.get("A1", "")) == pytest.approx(here["A1"] + 20.0, abs=1e-4)
    assert lock_step_world.clock.now_s() - before_s > 20.0 / 36.0
    assert lock_step_world.arm().at_rest
    assert not lock_step_world.clock.streaming()


def test_a_motion_by_eki_is_stopped_on_its_way(cell: Callable[..., Cell]) -> None:
    eki = cell().project()
    assert eki.command("DRIVES", On=1) == 0
    axes = eki.state(Id="8").find("Axis")
    assert axes is not None
    here = {name: float(value) for name, value in axes.attrib.items()}
    eki.socket.sendall(_ptp(22, {**here, "A1": here["A1"] + 150.0}, 5))
    eki.state(Moving="1", ProState="P_ACTIVE")
    assert eki.command("RSI_START") == 4
    eki.socket.sendall(b'<Cmd Id="23" Name="STOP" Kind="FAST"></Cmd>')
    aborted = eki.until(lambda element: element.get("Id") == "22" and element.get("Code") != "0")
    assert aborted.get("Code") == "7"
    assert eki.until(lambda element: element.get("Id") == "23").get("Code") == "0"
    stopped = eki.state(Moving="0").find("Axis")
    assert stopped is not None
    assert here["A1"] <= float(stopped.get("A1", "")) < here["A1"] + 149.0


def _ptp(identifier: int, axes_deg: dict[str, float], speed_percent: int) -> bytes:
    attributes = " ".join(f'{name}="{angle:.4f}"' for name, angle in axes_deg.items())
    return f'<Cmd Id="{identifier}" Name="PTP_AXIS" {attributes} Vel="{speed_percent}"></Cmd>'.encode()
