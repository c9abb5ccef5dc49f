"""ndicapi, the C library of PLUS and scikit-surgery, by its Python module."""

from __future__ import annotations

import os
from contextlib import suppress
from functools import partial
from typing import Any

import ndicapy  # type: ignore[import-not-found]
from simulated_peer import address, clear, eventually, inject

ROMS = os.environ["ROMS"].split(os.pathsep)


def command(device: Any, line: str) -> str:
    with suppress(UnicodeDecodeError):  # it makes text of a binary reply, after it has read it
        return str(ndicapy.ndiCommand(device, line))
    return ""


def tracking(tools: int) -> Any:
    device = ndicapy.ndiOpenNetwork(*address("LINE"))
    return track(device, tools)


def track(device: Any, tools: int) -> Any:
    command(device, "INIT:")
    for rom in ROMS[:tools]:
        command(device, "PHRQ:*********1****")
        handle = ndicapy.ndiGetPHRQHandle(device)
        ndicapy.ndiPVWRFromFile(device, handle, rom)
        command(device, f"PINIT:{handle:02X}")
        command(device, f"PENA:{handle:02X}D")
    command(device, "TSTART:80")
    return device


def poses(device: Any, line: str, tools: int) -> list[Any]:
    command(device, line)
    return [
        getattr(ndicapy, f"ndiGet{line[:2]}Transform")(device, bytes([handle + 1])) for handle in range(tools)
    ]


def are_in_place(found: list[Any]) -> bool:
    places = [(-150.0, -300.0 + 200.0 * number, -1500.0) for number in range(len(found))]
    return all(
        isinstance(pose, tuple) and max(abs(a - b) for a, b in zip(pose[4:7], place, strict=True)) < 1.0
        for pose, place in zip(found, places, strict=True)
    )


def connects_by_network() -> None:
    device = ndicapy.ndiOpenNetwork(*address("LINE"))
    assert command(device, "INIT:") == "OKAY"


def connects_by_serial_line() -> None:
    path = os.environ["LINE"].removeprefix("serial://")
    assert ndicapy.ndiProbe(path) == 0, "probing the line finds no unit"
    assert are_in_place(poses(track(ndicapy.ndiOpen(path), 1), "TX:0801", 1))


def reads_a_tool_as_text() -> None:
    assert are_in_place(poses(tracking(1), "TX:0801", 1))


def reads_a_tool_as_binary() -> None:
    assert are_in_place(poses(tracking(1), "BX:0801", 1))


def reads_three_tools_as_text() -> None:
    assert are_in_place(poses(tracking(3), "TX:0801", 3))


def reads_three_tools_as_binary() -> None:
    device = tracking(3)
    ndicapy.ndiCommand(device, "BX:0801")  # the length of the reply, 0x81, is no UTF-8
    assert are_in_place(poses(device, "BX:0801", 3))


def says_that_a_tool_is_hidden() -> None:
    device = tracking(2)
    inject("tracker hide tool 1")
    for line in ("TX:0801", "BX:0801"):
        assert eventually(partial(is_hidden, device, line)), "a hidden tool has a pose"
        assert isinstance(poses(device, line, 2)[1], tuple), "the other tool is missing too"
    clear()
    assert eventually(lambda: are_in_place(poses(device, "BX:0801", 2)))


def is_hidden(device: Any, line: str) -> bool:
    return poses(device, line, 1) == ["MISSING"]


def reads_the_status_of_a_tool_at_the_edge() -> None:
    device = tracking(1)
    inject("tracker move tool 1 0 -300 0 mm")  # some of its markers are outside the volume
    assert eventually(lambda: status(device, "TX") == 0xB1)
    assert status(device, "BX") == 0xB1, "all higher bits of the binary status are set too"


def status(device: Any, kind: str) -> int:
    command(device, f"{kind}:0801")
    return int(getattr(ndicapy, f"ndiGet{kind}PortStatus")(device, b"\x01"))


def reads_strays() -> None:
    device = tracking(1)
    for kind in ("TX", "BX"):
        command(device, f"{kind}:1801")
        count = getattr(ndicapy, f"ndiGet{kind}NumberOfPassiveStrays")(device)
        places = [getattr(ndicapy, f"ndiGet{kind}PassiveStray")(device, number) for number in range(count)]
        assert count == 3
        assert all(place[2] < -900.0 for place in places), "a stray is not in front of the unit"


def reads_frame_numbers() -> None:
    device = tracking(1)
    first = frame(device)
    assert eventually(lambda: first < frame(device) < first + 1000)


def frame(device: Any) -> int:
    command(device, "BX:0801")
    return int(ndicapy.ndiGetBXFrame(device, b"\x01"))


def tells_errors_by_their_code() -> None:
    device, said = tracking(1), ""
    try:
        command(device, "PHF:7F")
    except OSError as error:
        said = str(error)
    assert "0x0c" in said, "nothing says that this command is refused while tracking"


def tells_warnings() -> None:
    device = ndicapy.ndiOpenNetwork(*address("LINE"))
    inject("tracker alert 8")
    assert command(device, "INIT:").startswith("WARNING")


def refuses_garbled_replies() -> None:
    device = tracking(1)
    inject("tracker garble replies 100 %")
    try:
        command(device, "TX:0001")
    except OSError:
        return
    raise AssertionError("a garbled reply passes for a good one")


def survives_noise_on_the_line() -> None:
    device = tracking(1)
    inject("tracker garble replies 50 %")
    for _ in range(300):
        with suppress(OSError):
            command(device, "TX:0801")
    clear()
    assert are_in_place(poses(device, "TX:0801", 1))


def survives_noise_in_binary_replies() -> None:
    device = tracking(1)
    inject("tracker garble replies 50 %")
    for _ in range(300):
        with suppress(OSError):
            command(device, "BX:0801")
    clear()
    assert are_in_place(poses(device, "BX:0801", 1))


def gives_up_when_no_reply_comes() -> None:
    device = tracking(1)
    inject("tracker lose replies 100 %")
    with suppress(OSError):
        command(device, "TX:0001")
        raise AssertionError("no reply passes for one")


def gives_up_when_no_reply_comes_on_a_serial_line() -> None:
    device = track(ndicapy.ndiOpen(os.environ["LINE"].removeprefix("serial://")), 1)
    inject("tracker lose replies 100 %")
    with suppress(OSError):
        command(device, "TX:0001")
        raise AssertionError("no reply passes for one")


def gives_up_when_the_unit_has_gone() -> None:
    device = tracking(1)
    inject("tracker power off")
    with suppress(OSError):
        command(device, "TX:0001")
        raise AssertionError("a unit without power seems to reply")


def tells_that_the_unit_was_bumped() -> None:
    device = tracking(1)
    inject("tracker bump")
    assert eventually(lambda: has_alert(device, "TX")), "the system status hides the alert"
    assert has_alert(device, "BX"), "the system status hides the alert"


def has_alert(device: Any, kind: str) -> bool:
    command(device, f"{kind}:0801")
    return bool(getattr(ndicapy, f"ndiGet{kind}SystemStatus")(device) & 0x0100)
