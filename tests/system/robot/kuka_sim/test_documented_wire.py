"""The telegrams shown on the documentation page match what goes over the wire."""

from __future__ import annotations

import re
import socket
from pathlib import Path
from xml.etree import ElementTree

from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.child_process import ChildProcess, command

PAGE = Path(__file__).parents[4] / "docs/how-to/extending/a-client-of-your-own.md"
SHOWN = re.compile(r"```xml\n(.*?)\n```", re.DOTALL)
IPOC = re.compile(rb"(?<=<IPOC>)\d+")
LIMIT_S = 10.0


def form_of(xml: bytes) -> list[tuple[str, list[str]]]:
    """Elements and their attributes, in their order."""
    return [(element.tag, list(element.attrib)) for element in ElementTree.fromstring(xml).iter()]


def test_the_telegrams_on_the_page_match_those_of_the_simulator() -> None:
    telegram, reply, request, state = (text.encode() for text in SHOWN.findall(PAGE.read_text()))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream:
        stream.bind(("127.0.0.1", 0))
        stream.settimeout(LIMIT_S)
        channels = ("--eki", "tcp://127.0.0.1:0", "--eki-project", "tcp://127.0.0.1:0")
        where = f"udp://127.0.0.1:{stream.getsockname()[1]}"
        arguments = command("sim.cli", "kuka", "--autostart", "--rsi", where, *channels)
        with ChildProcess("ronna-sim kuka", arguments) as child:
            angles = set()
            while "0.0100" not in angles:  # the correction of the page has reached the arm
                sent, sender = stream.recvfrom(4096)
                assert form_of(sent) == form_of(telegram)
                angles.add(re.findall(r'A1="([^"]*)"', sent.decode())[0])
                found = IPOC.search(sent)
                assert found is not None
                stream.sendto(IPOC.sub(found[0], reply), sender)
            eki = parse_endpoint(child.ready["endpoints"]["eki_project"])
            with socket.create_connection((eki.host, eki.port), LIMIT_S) as channel:
                channel.sendall(request)
                received = b""
                while (answer := re.search(rb'<State Id="1".*?</State>', received)) is None:
                    received += channel.recv(4096)
                assert form_of(answer[0]) == form_of(state)
