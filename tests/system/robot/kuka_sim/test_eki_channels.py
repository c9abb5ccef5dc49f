"""Both EKI channels and motions by EKI: plain TCP clients that know nothing of our driver."""

from __future__ import annotations

import re
import signal
import socket
import struct
from collections.abc import Callable

import pytest
from kuka_clients import Cell
from waiting import STALL_OF_THE_COMPUTER_S

from ronna_hw.host.child_process import STOP_TIMEOUT_S
from ronna_hw.wire.kuka_context import context_hash, load_context
from sim.world.world import World


def test_the_state_contains_everything_a_driver_must_know_before_motion(cell: Callable[..., Cell]) -> None:
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
        "Serial": "601234",
        "Brakes": "0",
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


@pytest.mark.hazard(34)
def test_a_second_client_is_refused_and_losing_a_client_does_not_end_the_run(
    cell: Callable[..., Cell],
) -> None:
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


def test_unterminated_garbage_closes_the_channel_but_not_the_controller(cell: Callable[..., Cell]) -> None:
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


def test_the_sdk_channel_follows_its_states_with_one_telegram_per_write(cell: Callable[..., Cell]) -> None:
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
def test_the_controller_ends_within_two_seconds_of_a_signal_while_streaming(
    cell: Callable[..., Cell], number: signal.Signals
) -> None:
    here = cell("--autostart")
    here.rsi.cycles(5)
    here.child.process.send_signal(number)
    assert here.child.process.wait(STOP_TIMEOUT_S + STALL_OF_THE_COMPUTER_S) == 0


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
    assert not lock_step_world.clock.is_streaming()


def _ptp(identifier: int, axes_deg: dict[str, float], speed_percent: int) -> bytes:
    attributes = " ".join(f'{name}="{angle:.4f}"' for name, angle in axes_deg.items())
    return f'<Cmd Id="{identifier}" Name="PTP_AXIS" {attributes} Vel="{speed_percent}"></Cmd>'.encode()
