"""Where people at other computers may look at a page: one address of this computer, behind TLS."""

from __future__ import annotations

import ipaddress
import socket
import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from ronna_hw.command_line.errors import UsageMistake

BindOption = Annotated[
    str | None,
    typer.Option(
        "--bind", metavar="ADDRESS", help="Show the page to viewers of a network too, at this address."
    ),
]
CertificateOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="PEM certificate of the page of --bind.")
]
KeyOption = Annotated[Path | None, typer.Option(metavar="FILE", help="PEM key of --certificate.")]
FAMILIES = (socket.AF_INET, socket.AF_INET6)
WARNING = "whoever gets that address sees this patient; from there nobody operates"
READABLE_BY_OTHERS = 0o044


@dataclass(frozen=True)
class ViewersAddress:
    """An address with the files of its certificate; the page has it for viewers only."""

    address: str
    certificate: Path
    key: Path

    def check(self) -> tuple[str, ...]:
        """What is to be warned of. Raises CLI-001 for what no page is served at."""
        try:
            address = ipaddress.ip_address(self.address)
        except ValueError:
            raise UsageMistake(
                f"--bind {self.address} is no address", expected="a number such as 192.168.1.20"
            ) from None
        if address.is_unspecified:
            raise UsageMistake(
                f"--bind {self.address} would serve every network of this computer",
                action="Name the one address that the viewers' network reaches.",
            )
        if address.is_loopback:
            raise UsageMistake(
                f"--bind {self.address} is this computer itself", action="Leave it out: it is served anyway."
            )
        if address not in own_addresses():
            raise UsageMistake(
                f"--bind {self.address} is no address of this computer", action="ip address lists them."
            )
        self.context()
        warnings = [WARNING]
        if address.is_global:
            warnings.append(f"{self.address} is an address of the internet, not of a network of your own")
        if self.key.stat().st_mode & READABLE_BY_OTHERS:
            warnings.append(f"other users of this computer can read {self.key.name}: chmod 600")
        return tuple(warnings)

    @property
    def family(self) -> socket.AddressFamily:
        """Of its sockets."""
        return socket.AF_INET6 if ":" in self.address else socket.AF_INET

    def host(self, port: int) -> str:
        """As it stands in an address and in the header Host."""
        return f"[{self.address}]:{port}" if ":" in self.address else f"{self.address}:{port}"

    def context(self) -> ssl.SSLContext:
        """Raises CLI-001 for files that are no certificate and key."""
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        try:
            context.load_cert_chain(self.certificate, self.key, password=lambda: "")
        except (OSError, ValueError) as error:  # an ssl.SSLError is an OSError
            raise UsageMistake(
                f"{self.certificate.name} and {self.key.name} are no certificate with its key: {error}",
                action="Give two PEM files; the key without a password.",
            ) from error
        return context


def own_addresses() -> set[ipaddress.IPv4Address | ipaddress.IPv6Address]:
    """Of this computer's network cards."""
    import psutil

    cards = psutil.net_if_addrs().values()
    told = (one.address.partition("%")[0] for card in cards for one in card if one.family in FAMILIES)
    return {ipaddress.ip_address(address) for address in told}


def viewers_address(bind: str | None, certificate: Path | None, key: Path | None) -> ViewersAddress | None:
    """What the options ask for, checked; None without them. Raises CLI-001."""
    if bind is None:
        if certificate is not None or key is not None:
            raise UsageMistake("--certificate and --key go with --bind")
        return None
    if certificate is None or key is None:
        raise UsageMistake(
            "--bind needs --certificate and --key: a patient is not shown to a network in the clear",
            action="Give both PEM files; openssl req -x509 -newkey makes a pair for a rehearsal.",
        )
    return ViewersAddress(bind, certificate, key)
