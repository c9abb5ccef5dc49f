"""RTDE, byte by byte: versions, recipes, who owns which input, packages too long and too short."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest
from ur_clients import package

from sim.universal_robots.controller import Controller
from sim.universal_robots.rtde.server import RtdeServer
from sim.universal_robots.rtde.session import BadPackage, Session
from sim.universal_robots.variables import TIMESTAMP

MakeController = Callable[..., Controller]
Serve = Callable[[Controller], RtdeServer]


class Client:
    def __init__(self, server: RtdeServer, version: int = 2) -> None:
        self.session = Session(server)
        if version > 1:
            assert self.ask("V", struct.pack(">H", version)) == b"\1"

    def tell(self, kind: str, payload: bytes) -> list[bytes]:
        self.session.receive(package(kind, payload))
        answers, self.session.answers = self.session.answers, []
        return answers

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        (answer,) = self.tell(kind, payload)
        assert struct.unpack(">HB", answer[:3]) == (len(answer), ord(kind))
        return answer[3:]

    def outputs(self, names: str, rate_hz: float = 500.0) -> bytes:
        return self.ask("O", struct.pack(">d", rate_hz) + names.encode())


@pytest.fixture
def server(serve: Serve, controller: Controller) -> RtdeServer:
    return serve(controller)


def test_a_refused_protocol_version_leaves_the_connection_as_it_is(server: RtdeServer) -> None:
    client = Client(server)
    assert client.ask("V", b"\0\3") == b"\0"
    assert client.outputs("timestamp") == b"\1DOUBLE"


# Version 1 as the guide describes it, byte by byte: what a client sends, and the answer.
VERSION_1_LOG = (
    ("0003 76", "0013 76 00000005 0000000b 00000005 000f6a97"),  # v: 5.11.5, build 1010327
    ("000c 4f" + b"timestamp".hex(), "0009 4f" + b"DOUBLE".hex()),  # O: neither rate nor recipe number
    ("0018 49" + b"input_int_register_24".hex(), "0009 49 01" + b"INT32".hex()),  # I: recipe 1
    ("0003 53", "0004 53 01"),  # S
    ("0008 55 01 fffffff9", ""),  # U: -7, without answer
    ("0003 50", "0004 50 01"),  # P
    ("0005 56 0009", "0004 56 00"),  # V: 9 is refused
    ("0011 4f" + b"no_such_field,".hex(), "000c 4f" + b"NOT_FOUND".hex()),
    ("0003 53", "0004 53 00"),
)


def test_version_1_byte_by_byte(server: RtdeServer, controller: Controller) -> None:
    client = Client(server, version=1)
    for request, answer in VERSION_1_LOG:
        client.session.receive(bytes.fromhex(request))
        answers, client.session.answers = client.session.answers, []
        assert b"".join(answers) == bytes.fromhex(answer)
        if client.session.started and client.session.output is not None:
            package_1_s = bytes.fromhex("000b 55 3ff0000000000000")
            controller.robot.values[TIMESTAMP] = 1.0
            assert client.session.output.pack(controller.robot.values) == package_1_s
    assert controller.robot.input_int(24) == -7
    client.session.receive(bytes.fromhex("0004 55 01"))
    assert client.session.answers[0][2:4] == b"M\2"  # a warning, then its text


def test_an_old_controller_leaves_its_client_at_version_1(make: MakeController, serve: Serve) -> None:
    client = Client(serve(make("newest_rtde_version=1")), version=1)
    assert client.ask("V", b"\0\2") == b"\0"
    assert client.ask("O", b"timestamp,robot_mode") == b"DOUBLE,INT32"


def test_an_unknown_output_is_named_and_nothing_starts(server: RtdeServer) -> None:
    client = Client(server)
    assert client.outputs("timestamp,no_such_field") == b"\0DOUBLE,NOT_FOUND"
    assert client.ask("S") == b"\0"


def test_a_package_has_the_values_in_the_order_of_the_recipe(
    server: RtdeServer, controller: Controller
) -> None:
    client = Client(server)
    assert client.outputs("safety_mode,target_q,timestamp,") == b"\1INT32,VECTOR6D,DOUBLE"
    recipe = client.session.output
    assert recipe is not None
    target = controller.robot.drives.target
    assert recipe.pack(controller.robot.values) == package("U", struct.pack(">Bi7d", 1, 1, *target, 0.0))


@pytest.mark.parametrize(("rate_hz", "divider"), [(500.0, 1), (125.0, 4), (300.0, 1), (1.0, 500), (0.0, 1)])
def test_the_rate_is_a_whole_fraction_of_the_cycles(server: RtdeServer, rate_hz: float, divider: int) -> None:
    client = Client(server)
    client.outputs("timestamp", rate_hz)
    assert client.session.output is not None
    assert client.session.output.divider == divider


def test_start_needs_outputs_and_pause_ends_them(server: RtdeServer) -> None:
    client = Client(server)
    assert client.ask("S") == b"\0"
    client.outputs("timestamp")
    assert client.ask("S") == b"\1"
    assert client.session.started
    assert client.ask("P") == b"\1"
    assert not client.session.started


def test_input_recipes_are_numbered_in_each_connection_and_names_may_repeat(server: RtdeServer) -> None:
    client, other = Client(server), Client(server)
    assert client.ask("I", b"input_int_register_0") == b"\1INT32"
    assert client.ask("I", b"input_int_register_0,input_double_register_0") == b"\2INT32,DOUBLE"
    assert other.ask("I", b"input_int_register_1") == b"\1INT32"


def test_an_input_of_another_client_is_in_use_until_it_has_gone(server: RtdeServer) -> None:
    client, other = Client(server), Client(server)
    client.ask("I", b"input_int_register_24")
    wanted = b"input_int_register_24,input_int_register_25,nothing"
    assert other.ask("I", wanted) == b"\0IN_USE,INT32,NOT_FOUND"
    server.forget(client.session)
    assert other.ask("I", b"input_int_register_24") == b"\1INT32"


def test_anybody_can_read_inputs_back(server: RtdeServer, controller: Controller) -> None:
    writer, reader = Client(server), Client(server)
    writer.ask("I", b"input_double_register_30,input_int_register_24")
    writer.tell("U", struct.pack(">Bdi", 1, 2.5, -7))
    reader.outputs("input_int_register_24,input_double_register_30")
    assert reader.session.output is not None
    values = controller.robot.values
    assert reader.session.output.pack(values)[4:] == struct.pack(">id", -7, 2.5)


def test_of_a_package_longer_than_its_recipe_the_front_counts(
    server: RtdeServer, controller: Controller
) -> None:
    client = Client(server)
    client.ask("I", b"input_int_register_0,input_double_register_0")
    assert client.tell("U", struct.pack(">Bi3d", 1, 43, 1.5, 2.5, 3.5)) == []
    assert controller.robot.input_int(0) == 43
    assert controller.robot.input_doubles(0, 2) == [1.5, 0.0]


def test_a_package_shorter_than_its_recipe_changes_nothing_and_gets_a_message(
    server: RtdeServer, controller: Controller
) -> None:
    client = Client(server)
    client.ask("I", b"input_int_register_0,input_double_register_0")
    (answer,) = client.tell("U", struct.pack(">Bi", 1, 43))
    assert answer[2] == ord("M")
    assert controller.robot.input_int(0) == 0


def test_requests_may_arrive_in_pieces_and_together(server: RtdeServer) -> None:
    client = Client(server)
    stream = package("v") + package("P") + package("V", b"\0\2")
    for number in range(len(stream)):
        client.session.receive(stream[number : number + 1])
    assert [answer[2:3] for answer in client.session.answers] == [b"v", b"P", b"V"]


@pytest.mark.parametrize("data", [b"\0\2V", package("?"), package("O"), package("I", b"x" * 2049)])
def test_what_is_no_rtde_ends_the_connection(server: RtdeServer, data: bytes) -> None:
    client = Client(server)
    with pytest.raises(BadPackage):
        client.session.receive(data)


def test_inputs_beyond_registers_act_only_under_their_mask(
    server: RtdeServer, controller: Controller
) -> None:
    client = Client(server)
    client.ask("I", b"speed_slider_mask,speed_slider_fraction")
    client.ask("I", b"standard_digital_output_mask,standard_digital_output")
    client.tell("U", struct.pack(">BId", 1, 0, 0.25))
    assert controller.robot.speed_fraction == 1.0
    client.tell("U", struct.pack(">BId", 1, 1, 0.25))
    client.tell("U", struct.pack(">BBB", 2, 0b0110, 0b0011))
    client.outputs("target_speed_fraction,actual_digital_output_bits")
    assert client.session.output is not None
    values = controller.robot.values
    assert client.session.output.pack(values)[4:] == struct.pack(">dQ", 0.25, 0b0010)
