"""Users of serial and network ports are named, and permissions come with the command that fixes them."""

from __future__ import annotations

import os
import socket
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from ronna_hw.host.port_users import (
    advise_on_permission,
    describe_permissions,
    find_serial_port_users,
    find_tcp_clients,
    find_udp_port_user,
)

OPENS_OURS = (
    "import sys; port = open(sys.argv[1], 'r+b', buffering=0); print('open', flush=True); sys.stdin.read()"
)
MAKES_ITS_OWN = "import os, sys; m, s = os.openpty(); print(os.ttyname(s), flush=True); sys.stdin.read()"
Start = Callable[..., tuple[int, str]]


@pytest.fixture
def start() -> Iterator[Start]:
    """Run a script as another process; returns its id and the first line that it prints."""
    children: list[subprocess.Popen[str]] = []

    def started(script: str, *arguments: str) -> tuple[int, str]:
        command = [sys.executable, "-c", script, *arguments]
        child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        children.append(child)
        assert child.stdout is not None
        return child.pid, child.stdout.readline().strip()

    yield started
    for child in children:
        child.communicate("")


@pytest.fixture
def terminal() -> Iterator[str]:
    """Path of a pseudo-terminal whose both sides are ours."""
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_another_process_using_a_serial_port_is_reported_with_its_command_line(
    start: Start, terminal: str
) -> None:
    assert find_serial_port_users(terminal) == ()
    pid, _ = start(OPENS_OURS, terminal)
    (user,) = find_serial_port_users(terminal)
    assert user.pid == pid
    assert sys.executable[:20] in user.name
    assert f"(pid {pid})" in str(user)


CONNECTS = (
    "import socket, sys; there = socket.create_connection(('127.0.0.1', int(sys.argv[1])));"
    " print('open', flush=True); sys.stdin.read()"
)


def test_another_process_connected_to_a_tcp_port_is_reported_and_this_one_is_not(start: Start) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port)):
            assert find_tcp_clients("localhost", port) == ()
        pid, _ = start(CONNECTS, str(port))
        (user,) = find_tcp_clients("localhost", port)
    assert user.pid == pid


def test_the_process_on_the_master_side_of_a_terminal_is_not_reported(start: Start) -> None:
    _, path = start(MAKES_ITS_OWN)
    assert find_serial_port_users(path) == ()


STARTS_A_SERVANT = (  # whose command line is that of a process of ours: `python -P -m MODULE`
    "import subprocess, sys;"
    " child = subprocess.Popen([sys.executable, '-P', '-m', 'timeit', '-n1', '-r1', '-s', sys.argv[1]],"
    " stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True);"
    " print(child.stdout.readline(), flush=True); sys.stdin.read(); child.communicate('')"
)
BINDS = (
    "import socket, sys; port = socket.socket(type=socket.SOCK_DGRAM); port.bind(('127.0.0.1', 0));"
    " print(port.getsockname()[1], flush=True); sys.stdin.read()"
)


def test_a_process_that_serves_another_is_reported_as_that_one(start: Start) -> None:
    pid, port = start(STARTS_A_SERVANT, BINDS)
    user = find_udp_port_user("127.0.0.1", int(port))
    assert user is not None
    assert user.pid == pid


def test_a_port_that_does_not_exist_has_no_users() -> None:
    assert find_serial_port_users("/dev/no-such-port") == ()


@pytest.mark.parametrize("bound", ["127.0.0.1", "0.0.0.0"])
def test_the_process_bound_to_a_udp_port_is_reported(bound: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        ours.bind((bound, 0))
        port = ours.getsockname()[1]
        user = find_udp_port_user("127.0.0.1", port)
        assert user is not None
        assert user.pid == os.getpid()
        assert (find_udp_port_user("127.0.0.2", port) is None) == (bound == "127.0.0.1")
    assert find_udp_port_user("127.0.0.1", port) is None


def test_permission_advice_depends_on_the_group_access_to_the_port(tmp_path: Path) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    port.chmod(stat.S_IRUSR | stat.S_IWUSR | stat.S_IRGRP | stat.S_IWGRP)
    assert "sudo usermod -aG " in advise_on_permission(str(port))
    assert describe_permissions(str(port)).startswith("-rw-rw---- ")
    port.chmod(stat.S_IRUSR)
    assert "udev" in advise_on_permission(str(port))
    assert "dialout" in advise_on_permission("/dev/no-such-port")
