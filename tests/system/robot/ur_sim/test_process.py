"""The controller as a process: its ports, several clients, lock-step, faults."""

from __future__ import annotations

import struct
import subprocess
import time

import pytest
from ur_clients import RUN, RtdeClient, UrCell, stream

from ronna_hw.control_port import ask_control_port
from ronna_hw.host.child_process import command
from ronna_hw.wire.universal_robots import RuntimeState, SafetyMode, ScriptState
from sim.world.faults import FaultKind
from sim.world.faults.universal_robots import UR_FAULTS

HANG_S = 60.0
STEP_RAD = 0.0005


def test_it_serves_the_standard_ports_and_says_what_it_is(cell: UrCell) -> None:
    assert cell.child.ready["device"] == "ur"
    assert {name: text.rpartition(":")[2] for name, text in cell.endpoints.items()} == {
        "rtde": "30004",
        "dashboard": "29999",
        "primary": "30001",
        "secondary": "30002",
        "realtime": "30003",
    }
    assert cell.rtde().ask("v") == struct.pack(">4I", 3, 15, 8, 106339)
    assert cell.dashboard("robotmode") == "Robotmode: RUNNING"
    with cell.connect("primary") as primary:
        assert primary.recv(100)[4:5] == b"\x14"
    with cell.connect("realtime") as realtime:
        assert int.from_bytes(realtime.recv(4), "big") == 1108
    again = command("sim.cli", "ur", "--address", cell.address)
    refused = subprocess.run(again, capture_output=True, text=True, timeout=HANG_S)
    assert refused.returncode != 0
    assert "SIM-004" in refused.stderr


def test_in_lock_step_each_answered_package_is_one_cycle(lock_step_cell: UrCell) -> None:
    client, home = stream(lock_step_cell)
    watcher = lock_step_cell.rtde()
    assert watcher.ask("I", b"input_int_register_24") == b"\0IN_USE"
    last_s = None
    for number in range(2, 402):
        joints = [home[0] + number * STEP_RAD, *home[1:]]
        client.put(number, 0, RUN, joints)
        state = client.state()
        assert state.used == number
        assert last_s is None or state.timestamp_s == pytest.approx(last_s + 0.002)
        last_s = state.timestamp_s
    client.socket.close()
    reader = lock_step_cell.rtde()
    assert reader.ask("O", struct.pack(">d", 500.0) + b"output_int_register_25,runtime_state")[0]
    reader.ask("S")
    while struct.unpack(">iI", reader.next("U")[1:]) != (ScriptState.STARVED, RuntimeState.STOPPED):
        pass


def read_on(client: RtdeClient) -> None:
    while True:
        client.next("U")


def test_only_the_client_that_does_not_read_is_disconnected(cell: UrCell) -> None:
    reader, sleeper = cell.rtde(), cell.rtde(receive_bytes=4096)
    names = ",".join(f"output_double_register_{number}" for number in range(48)) + ",target_q,actual_q"
    for client in (reader, sleeper):
        assert client.ask("O", struct.pack(">d", 500.0) + names.encode())[0]
        assert client.ask("S") == b"\1"
    for _ in range(120):
        reader.next("U")
    with pytest.raises(ConnectionResetError):
        read_on(sleeper)
    reader.next("U")


def line_of(kind: FaultKind) -> str:
    values = {"INT": "2", "NUMBER": "5", "SIGNED": "+5"}
    return " ".join(["ur", *(values.get(word, word) for word in kind.phrase.split())])


def test_every_fault_can_be_switched_on_live_and_is_logged_with_its_cycle(cell: UrCell) -> None:
    control = cell.child.ready["control"]
    for kind in UR_FAULTS:
        ask_control_port(control, "fault", line=f"now: {line_of(kind)}")
        wanted = f": {line_of(kind)}" + ("" if kind.momentary else " begins")
        deadline = time.monotonic() + HANG_S
        while not any(", cycle " in line and line.endswith(wanted) for line in cell.child.messages):
            assert time.monotonic() < deadline, kind.name
            time.sleep(0.001)
        ask_control_port(control, "clear_faults")
    assert cell.child.alive


def test_faults_reach_a_client_that_streams(lock_step_cell: UrCell) -> None:
    client, home = stream(lock_step_cell)
    control = lock_step_cell.child.ready["control"]

    ask_control_port(control, "fault", line="now: ur speed slider 50 %")
    ask_control_port(control, "fault", line="now: ur late 3 cycles")
    for number in range(2, 20):
        client.put(number, 0, RUN, home)
        state = client.state()
    assert state.used == 19 - 3
    ask_control_port(control, "clear_faults")
    ask_control_port(control, "fault", line="now: ur protective stop")
    number = 20
    while state.safety_mode != SafetyMode.PROTECTIVE_STOP:
        client.put(number, 0, RUN, home)
        state = client.state()
        number += 1
    while state.runtime != RuntimeState.PAUSED:
        state = client.state()
    while lock_step_cell.dashboard("unlock protective stop") != "Protective stop releasing":
        client.state()
