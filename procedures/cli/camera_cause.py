"""What a probe of a camera's address means, in plain words: what was seen, the likely cause, what to do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from procedures.cli.camera_probe import About, Access, CameraProbe, Control
from procedures.cli.line_cause import Verdict
from ronna_hw.host.network_interfaces import Interface

JUMBO_BYTES = 8000  # below, both cameras at full rate keep a computer busy


def judge(
    probe: CameraProbe, found: Sequence[About] = (), serial: str | None = None, model: str | None = None
) -> Verdict:
    """Say what the probe means. `found` answered a question to everybody; serial and model are awaited."""
    if probe.access is not Access.ANSWERED or probe.about is None:
        return _unanswered(probe, found)
    seen = "; ".join(_seen(probe))
    if model and probe.about.model != model:
        return Verdict(False, seen, f"Another device: a {model} was awaited. Check address and cable.")
    if serial and probe.about.serial != serial:
        return Verdict(False, seen, _wrong_serial(probe.about, serial, found))
    if probe.control is not None and probe.control.taken:
        return Verdict(False, seen, _taken(probe.control))
    if probe.packet_bytes is None:
        return Verdict(False, seen, "It gave no control although nobody has it: switch it off and on.")
    if not probe.packet_bytes:
        advice = "No test packet came: a firewall drops UDP from the camera, or it sends none at all."
        return Verdict(False, seen, advice)
    if probe.packet_bytes < JUMBO_BYTES:
        return Verdict(True, seen, _small_packets(probe.interface))
    return Verdict(True, seen)


def document(probe: CameraProbe, verdict: Verdict) -> dict[str, Any]:
    """The probe and its verdict as plain data."""
    return {
        "endpoint": str(probe.endpoint),
        "well": verdict.well,
        "access": probe.access.value,
        "interface": asdict(probe.interface) if probe.interface else None,
        "camera": asdict(probe.about) if probe.about else None,
        "control": asdict(probe.control) if probe.control else None,
        "packet_bytes": probe.packet_bytes,
        "seen": verdict.seen,
        "cause": verdict.advice,
    }


def _seen(probe: CameraProbe) -> Iterator[str]:
    about = probe.about
    assert about is not None
    yield f"{about.vendor} {about.model} {about.serial}".strip()
    if probe.interface is not None:
        yield f"by {probe.interface.name} ({probe.interface.address}, MTU {probe.interface.mtu_bytes})"
    control = probe.control
    if control is not None and control.taken:
        yield f"controlled by {_who(control)}"
    else:
        yield "nobody in control"
    if probe.packet_bytes:
        yield f"packets of {probe.packet_bytes} bytes pass"


def _who(control: Control) -> str:
    if control.holder is not None:
        return str(control.holder)
    return f"{control.address}:{control.port}" if control.port else "another program, which it does not name"


def _taken(control: Control) -> str:
    if control.holder is not None:
        return "End that program; a camera lets go of one that died within its heartbeat time-out."
    if control.here:
        return "That program has ended, or is another user's: wait for the heartbeat time-out, or ask for it."
    return "Close the program on the other computer, or wait for the heartbeat time-out of one that died."


def _wrong_serial(about: About, serial: str, found: Sequence[About]) -> str:
    if other := next((each for each in found if each.serial == serial), None):
        return (
            f"Camera {serial} is at {other.address}: swap the cables, or the endpoints in the theatre file."
        )
    return f"Camera {serial} was awaited and is nowhere. After a change of camera, calibrate the head anew."


def _small_packets(interface: Interface | None) -> str:
    where = f"{interface.name} has an MTU of {interface.mtu_bytes}" if interface else "the path is narrow"
    return f"{where}: for full frames at full rate allow jumbo frames on the card and every switch."


def _unanswered(probe: CameraProbe, found: Sequence[About]) -> Verdict:
    way = probe.interface
    if probe.access is Access.NO_WAY:
        return Verdict(
            False, f"no way there: {probe.reason}", "Give this computer an address in the camera's subnet."
        )
    by = f" by {way.name} ({way.address})" if way else ""
    elsewhere = _elsewhere(probe, found)
    if probe.access is Access.REFUSED:
        advice = elsewhere or "A computer is at this address, and no camera: check the address."
        return Verdict(False, f"refused{by}: nothing serves cameras' port there", advice)
    if way is not None and not way.loopback and not way.reaches(probe.endpoint.host):
        advice = elsewhere or "It is not in the subnet of any card here: camera and host must share one."
    else:
        advice = elsewhere or "Check power and cable of the camera, and its address in the theatre file."
    return Verdict(False, f"silent{by}", advice)


def _elsewhere(probe: CameraProbe, found: Sequence[About]) -> str:
    others = [each for each in found if each.address != probe.endpoint.host]
    if not others:
        return ""
    listed = ", ".join(f"{each.model} {each.serial} at {each.address}" for each in others[:4])
    return f"These cameras answer: {listed}. Correct the address in the theatre file."
