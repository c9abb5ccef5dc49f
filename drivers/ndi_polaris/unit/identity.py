"""Identity of the unit, checked against the theatre file."""

from __future__ import annotations

from drivers.ndi_polaris.errors import NotAPolaris, UnitError, WrongUnit
from drivers.ndi_polaris.line.command_link import CommandLink
from drivers.ndi_polaris.unit.user_parameters import read_parameter
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.wire.polaris import LF, PARAMETER_FIRMWARE

VENDOR = "NDI"
FAMILY = "Polaris"
VERSION_TEXT_BYTES = 512
_MODEL_ENDS_AT = " Control Firmware"


def read_identity(link: CommandLink, deadline_s: float) -> Identity:
    """Model, serial number and firmware from VER, GET and APIREV; raises NDI-003 for another device."""
    text = _ask_or(link, "VER", "4", deadline_s) or _ask_or(link, "VER", "0", deadline_s)
    lines = text.split(LF)
    model = lines[0].split(_MODEL_ENDS_AT)[0].strip()
    if FAMILY.lower() not in model.lower():
        raise NotAPolaris("the device does not identify itself as a Polaris", got=model or "no model")
    fields = _fields(lines[1:])
    try:
        firmware = read_parameter(link, PARAMETER_FIRMWARE, deadline_s)
    except UnitError:
        firmware = ""
    details = {
        "freeze tag": fields.get("freeze tag", ""),
        "characterization date": fields.get("characterization date", ""),
        "api revision": _ask_or(link, "APIREV", "", deadline_s),
        "combined firmware": _ask_or(link, "VER", "5", deadline_s),
    }
    return Identity(
        vendor=VENDOR,
        model=model,
        serial=fields.get("ndi s/n", ""),
        firmware=firmware or fields.get("freeze tag", ""),
        details=tuple((name, value.strip()) for name, value in details.items() if value.strip()),
    )


def check_identity(identity: Identity, model: str | None, serial: str | None) -> None:
    """Raise NDI-004 when model or serial number is not the expected one; None accepts any."""
    if model is not None and model.lower() not in identity.model.lower():
        raise WrongUnit("wrong model of unit", expected=model, got=identity.model)
    if serial is not None and serial != identity.serial:
        raise WrongUnit("wrong serial number", expected=serial, got=identity.serial or "none")


def _ask_or(link: CommandLink, name: str, argument: str, deadline_s: float) -> str:
    """The reply, or an empty text when the unit does not have the command or parameter."""
    try:
        return link.ask(name, argument, deadline_s=deadline_s, reply_bytes=VERSION_TEXT_BYTES)
    except UnitError:
        return ""


def _fields(lines: list[str]) -> dict[str, str]:
    pairs = (line.partition(":") for line in lines if ":" in line)
    return {name.strip().lower(): value.strip() for name, _, value in pairs}
