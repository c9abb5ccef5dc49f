"""The vendor's RTDE guide, read independently: a session's bytes, written out by hand.

Chosen numbers have short doubles: 0.25 is 3fd0..., 1.5 is 3ff8..., 100.002 s is the next cycle of 100 s.
"""

from __future__ import annotations

import os
import select
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace

import pytest
from rtde_stand import LIMITS, SETTINGS

from drivers.universal_robots.errors import RegistersInUse
from drivers.universal_robots.realtime.loop import Handover, LinkLoop
from drivers.universal_robots.rtde import RtdeSetup
from ronna_hw.arm_stream.mailbox import Mailbox
from ronna_hw.arm_stream.records import Command, OpenStream, StreamPhase

OUTPUT_NAMES = (
    b"timestamp,target_q,actual_q,speed_scaling,target_speed_fraction,robot_mode,safety_mode,runtime_state,"
    b"output_int_register_24,output_int_register_25,output_int_register_26,actual_TCP_force,"
    b"actual_current,target_current"
)
INPUT_NAMES = (
    b"input_int_register_24,input_int_register_25,input_int_register_26,"
    b"input_double_register_24,input_double_register_25,input_double_register_26,"
    b"input_double_register_27,input_double_register_28,input_double_register_29"
)
OUTPUT_TYPES = (
    b"DOUBLE,VECTOR6D,VECTOR6D,DOUBLE,DOUBLE,INT32,INT32,UINT32,INT32,INT32,INT32,VECTOR6D,VECTOR6D,VECTOR6D"
)
INPUT_TYPES = b"INT32,INT32,INT32,DOUBLE,DOUBLE,DOUBLE,DOUBLE,DOUBLE,DOUBLE"
SETUP = (  # request, reply
    (bytes.fromhex("0005 56 0002"), bytes.fromhex("0004 56 01")),
    (bytes.fromhex("0003 76"), bytes.fromhex("0013 76 00000005 0000000b 00000005 000f6a97")),
    (
        bytes.fromhex("00e3 4f 407f400000000000") + OUTPUT_NAMES,
        bytes.fromhex("006a 4f 01") + OUTPUT_TYPES,
    ),
    (bytes.fromhex("00da 49") + INPUT_NAMES, bytes.fromhex("003f 49 02") + INPUT_TYPES),
)
START = (bytes.fromhex("0003 53"), bytes.fromhex("0004 53 01"))
JOINTS = (
    "3fd0000000000000 bff8000000000000 bff8000000000000 bff8000000000000 3ff8000000000000 3fd0000000000000"
)
RUN = "0000002a"  # 42
NO_FORCE = "0000000000000000" * 18  # nor currents
# Size, type U, recipe 1, time stamp, target and actual joints, speeds 1.0, robot RUNNING, safety NORMAL.
HEAD = f"{JOINTS} {JOINTS} 3ff0000000000000 3ff0000000000000 00000007 00000001"
PACKAGES = (  # and the reply with the input recipe 2: sequence number, order, session, joints
    # stopped; registers of nobody
    (
        f"0124 55 01 4059000000000000 {HEAD} 00000001 00000000 00000000 00000000 {NO_FORCE}",
        f"0040 55 02 00000000 00000000 {RUN} {JOINTS}",
    ),
    # playing; script waiting, in our session
    (
        f"0124 55 01 40590020c49ba5e3 {HEAD} 00000002 00000000 00000001 {RUN} {NO_FORCE}",
        f"0040 55 02 00000001 00000000 {RUN} {JOINTS}",
    ),
    # streaming, with set-point 1
    (
        f"0124 55 01 4059004189374bc7 {HEAD} 00000002 00000001 00000002 {RUN} {NO_FORCE}",
        f"0040 55 02 00000002 00000000 {RUN} {JOINTS}",
    ),
    (
        f"0124 55 01 405900624dd2f1aa {HEAD} 00000002 00000002 00000002 {RUN} {NO_FORCE}",
        f"0040 55 02 00000003 00000000 {RUN} {JOINTS}",
    ),
)
TEXT_MESSAGE = bytes.fromhex("000b 4d 02 6869 03 727472 03")  # "hi" of "rtr", information


def receive(connection: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += connection.recv(count - len(data)) or pytest.fail("closed")
    return data


def test_setup_and_stream_are_byte_for_byte_those_of_the_guide() -> None:
    assert all(len(request) == int.from_bytes(request[:2]) for request, _ in SETUP)
    with socket.create_server(("127.0.0.1", 0)) as server:
        asked: list[bytes] = []

        def answer() -> None:
            with server.accept()[0] as controller:
                for request, reply in SETUP:
                    asked.append(receive(controller, len(request)))
                    controller.sendall(TEXT_MESSAGE + reply)  # messages may come in between

        thread = threading.Thread(target=answer)
        thread.start()
        setup = RtdeSetup("127.0.0.1", server.getsockname()[1], 10.0)
        assert str(setup.read_version()) == "5.11.5.1010327"
        assert (setup.set_up_outputs(500.0), setup.set_up_inputs()) == (1, 2)
        thread.join()
        setup.close()
    assert asked == [request for request, _ in SETUP]


def set_up(setup: RtdeSetup, controller: socket.socket, reply: bytes) -> int:
    """Return the recipe of our inputs, which the controller's reply gives; more may follow it."""
    replying = threading.Thread(
        target=lambda: receive(controller, len(SETUP[3][0])) and controller.sendall(reply)
    )
    replying.start()
    try:
        return setup.set_up_inputs()
    finally:
        replying.join()


@pytest.fixture
def connected() -> Iterator[tuple[RtdeSetup, socket.socket]]:
    """A set-up that has agreed on the version, and the controller's end of it."""
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(1) as pool:

        def accept() -> socket.socket:
            controller = server.accept()[0]
            receive(controller, len(SETUP[0][0]))
            controller.sendall(SETUP[0][1])
            return controller

        accepted = pool.submit(accept)
        setup = RtdeSetup("127.0.0.1", server.getsockname()[1], 10.0)
        with accepted.result() as controller, closing(setup):
            yield setup, controller


def test_a_package_that_begins_behind_the_last_reply_is_left_whole_to_the_stream(
    connected: tuple[RtdeSetup, socket.socket],
) -> None:
    setup, controller = connected
    assert set_up(setup, controller, SETUP[3][1] + TEXT_MESSAGE[:5]) == 2
    controller.sendall(TEXT_MESSAGE[5:])
    setup.socket.settimeout(10.0)
    assert receive(setup.socket, len(TEXT_MESSAGE)) == TEXT_MESSAGE


def test_a_reply_that_came_before_its_request_is_not_the_reply(
    connected: tuple[RtdeSetup, socket.socket],
) -> None:
    setup, controller = connected
    controller.sendall(SETUP[3][1])
    assert select.select((setup.socket,), (), (), 10.0)[0]
    in_use = SETUP[3][1].replace(b"INT32,DOUBLE", b"IN_USE,DOUBL")
    with pytest.raises(RegistersInUse):
        set_up(setup, controller, in_use)


@pytest.mark.parametrize("split", [1, 100, 149], ids=lambda count: f"in pieces of {count} bytes")
def test_each_package_is_answered_by_the_next_set_point(split: int) -> None:
    memory_fd, event_fd = os.memfd_create("log"), os.eventfd(0, os.EFD_NONBLOCK)
    Mailbox.initialise(memory_fd)
    mailbox = Mailbox(memory_fd)
    driver, process = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = socket.create_connection(server.getsockname())
        controller = server.accept()[0]
    settings = replace(SETTINGS, mailbox_fd=memory_fd, event_fd=event_fd, silence_limit_s=60.0)
    loop = LinkLoop(settings, process, mailbox)
    Handover(output_recipe=1, input_recipe=2, run=42).give(driver, ours)
    mailbox.write_command(Command(1, OpenStream(LIMITS)))
    loop._check_orders()
    assert receive(controller, 3) == START[0]
    controller.sendall(START[1] + TEXT_MESSAGE)
    controller.settimeout(10.0)
    for package, reply in PACKAGES:
        data = bytes.fromhex(package)
        assert len(data) == 0x124
        for begin in range(0, len(data), split):
            controller.sendall(data[begin : begin + split])
        while not _readable(controller):
            loop._step()
        assert receive(controller, 0x40) == bytes.fromhex(reply)
    assert loop.session.phase is StreamPhase.RUNNING
    assert loop.session.rejected == 0
    for end in (driver, controller, ours):
        end.close()
    loop.close()
    mailbox.close()
    os.close(memory_fd)
    os.close(event_fd)


def _readable(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return len(connection.recv(1, socket.MSG_PEEK)) == 1
    except BlockingIOError:
        return False
    finally:
        connection.settimeout(10.0)
