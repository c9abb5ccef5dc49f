"""pyigtl as a client of our server, and of messages on the wire that it would not send."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyigtl  # type: ignore[import-untyped]
from igtl_wire import IN_TWO, OTHER, POSE, VOXELS, WRONG_SUM, sending, served
from linked_case import TOOL_IN_RAS
from simulated_peer import eventually

from ronna_hw.wire.openigtlink_contents import Subscription, encode_subscription

LIMIT_S = 5.0
READING_LIMIT_S = 20.0  # of a CT, in a process of its own


class Question(pyigtl.MessageBase):  # type: ignore[misc]
    """A question, for which it has no class."""

    def __init__(self, kind: str, name: str = "", content: bytes = b"") -> None:
        super().__init__(device_name=name)
        self._message_type, self._content, self._valid_message = kind, content, True

    def _pack_content(self) -> bytes:
        return self._content


def told(name: str, *questions: Question, limit_s: float = LIMIT_S) -> Any:
    """Ask our server, and return what it tells of that name."""
    with served() as case:
        client = pyigtl.OpenIGTLinkClient("127.0.0.1", case.port)
        for question in questions:
            client.send_message(question, wait=True)
        return client.wait_for_message(name, timeout=limit_s)


def received(*parts: bytes) -> Any:
    with sending(*parts) as port:
        return pyigtl.OpenIGTLinkClient("127.0.0.1", port).wait_for_message("Tool", timeout=LIMIT_S)


def reads_a_transform() -> None:
    assert np.allclose(told("ToolToRas").matrix[:3], TOOL_IN_RAS)


def reads_a_text() -> None:
    assert told("RunState").string == "idle"


def reads_points() -> None:
    assert np.allclose(told("Spheres").positions, [[-1, -2, 3]])


def reads_a_status() -> None:
    assert told("tracker") is not None, "it drops STATUS: a tracker that fails looks idle"


def reads_a_trajectory() -> None:
    assert told("Plan") is not None, "it drops TRAJ: no plan arrives"


def reads_tracking_data() -> None:
    start = Question("STT_TDATA", content=encode_subscription(Subscription(10, "Ras")))
    assert told("ronna-hw", start) is not None, "it drops TDATA, the message of trackers"


def reads_an_image() -> None:
    ct = told("CT", Question("GET_IMAGE", "CT"), limit_s=READING_LIMIT_S)
    assert np.array_equal(np.squeeze(ct.image), VOXELS)


def reads_metadata() -> None:
    question = Question("GET_POINT", "Spheres")
    question.header_version = 2
    with served() as case:
        client = pyigtl.OpenIGTLinkClient("127.0.0.1", case.port)
        client.send_message(question, wait=True)
        assert eventually(lambda: client.wait_for_message("Spheres", timeout=LIMIT_S).metadata)


def skips_a_message_that_it_does_not_know() -> None:
    assert received(OTHER, POSE) is not None


def refuses_a_wrong_check_sum() -> None:
    assert received(WRONG_SUM) is None, "a wrong check sum is accepted"


def reads_a_message_that_comes_in_two_packets() -> None:
    assert received(*IN_TWO) is not None, "a header in two packets loses the stream"


def notices_that_the_server_has_gone() -> None:
    with served() as case:
        client = pyigtl.OpenIGTLinkClient("127.0.0.1", case.port)
        assert client.wait_for_message("RunState", timeout=LIMIT_S) is not None
    assert eventually(lambda: not client.is_connected(), LIMIT_S), (
        "it stays connected to a server that has gone"
    )
