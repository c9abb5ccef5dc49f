"""The process of both cameras: its addresses and its memory."""

from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest

from sim.basler.server import bind_pair
from sim.errors import EndpointTaken


def close(*sockets: socket.socket) -> None:
    for each in sockets:
        each.close()


def test_two_simulators_at_once_get_different_addresses() -> None:
    first, second = bind_pair(()), bind_pair(())
    addresses = {each.getsockname() for each in (*first, *second)}
    close(*first, *second)
    assert len(addresses) == 4
    assert {port for _, port in addresses} == {3956}
    assert all(address.startswith("127.77.") for address, _ in addresses)


def test_an_address_in_use_is_refused_and_nothing_stays_bound() -> None:
    first = bind_pair(())
    taken = first[1].getsockname()[0]
    with pytest.raises(EndpointTaken, match=rf"SIM-004.*3956.*in use by .*pid {os.getpid()}"):
        bind_pair(("127.99.3.7", taken))
    again = bind_pair(("127.99.3.7", "127.99.3.8"))
    close(*first, *again)


def test_an_address_of_another_machine_is_refused() -> None:
    with pytest.raises(EndpointTaken, match="it is no address of this computer"):
        bind_pair(("192.0.2.1", "192.0.2.2"))


SCRIPT = """
import resource, threading
import numpy as np
from sim.basler.command import keep_freed_memory

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        np.ones((1024, 1024), np.float32) * 2
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

kept = keep_freed_memory()
faults()
found = []
thread = threading.Thread(target=lambda: (faults(), found.append(faults())))
thread.start()
thread.join()
print(kept, found[0])
"""


def test_freed_memory_is_reused_with_few_page_faults() -> None:
    ended = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    kept, faults = ended.stdout.split()
    assert kept == "True"
    assert int(faults) < 200  # 40 arrays of 1024 pages each
