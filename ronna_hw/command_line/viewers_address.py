"""Address for serving a page to remote viewers over TLS."""

from __future__ import annotations

import ipaddress
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ronna_hw.command_line.errors import UsageMistake

if TYPE_CHECKING:
    import ssl

BindOption = Annotated[
    str | None,
    typer.Option(
        "--bind", metavar="ADDRESS", help="Also serve the page to viewers on the network, at this address."
    ),
]
CertificateOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="PEM certificate for the page at --bind.")
]
KeyOption = Annotated[Path | None, typer.Option(metavar="FILE", help="PEM key for --certificate.")]
FAMILIES = (socket.AF_INET, socket.AF_INET6)
WARNING = "anyone with this URL can view this patient; it gives no control"
READABLE_BY_OTHERS = 0o044


@dataclass(frozen=True)
class ViewersAddress:
    """This computer's address for remote viewers, with its TLS certificate."""

    address: str
    certificate: Path
    key: Path

    def check(self) -> tuple[str, ...]:
        """Check that the address can be served and return warnings to show. Raises CLI-001."""
        try:
            address = ipaddress.ip_address(self.address)
        except ValueError:
            raise UsageMistake(
                f"--bind {self.address} is not an address",
                expected="a number such as 192.168.1.20",
                action="List those of this computer with `ip address`.",
            ) from None
        if address.is_unspecified:
            raise UsageMistake(
                f"--bind {self.address} would serve all networks of this computer",
                action="Give the one address that is reachable from the viewers' network.",
            )
        if address.is_loopback:
            raise UsageMistake(
                f"--bind {self.address} is the loopback address",
                action="Omit it: this computer is always served.",
            )
        if address not in own_addresses():
            raise UsageMistake(
                f"--bind {self.address} is not an address of this computer",
                action="List them with `ip address`.",
            )
        self.context()
        warnings = [WARNING]
        if address.is_global:
            warnings.append(f"{self.address} is a public internet address, not one of a private network")
        if self.key.stat().st_mode & READABLE_BY_OTHERS:
            warnings.append(f"other users of this computer can read {self.key.name}: chmod 600")
        return tuple(warnings)

    @property
    def family(self) -> socket.AddressFamily:
        """Address family of the sockets."""
        return socket.AF_INET6 if ":" in self.address else socket.AF_INET

    def host(self, port: int) -> str:
        """Return the host as written in URLs and the Host header."""
        return f"[{self.address}]:{port}" if ":" in self.address else f"{self.address}:{port}"

    def context(self) -> ssl.SSLContext:
        """Build the TLS context. Raises CLI-001 unless the files are a certificate and its key."""
        import ssl  # on demand: every command has this option, few use it

        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        try:
            context.load_cert_chain(self.certificate, self.key, password=lambda: "")
        except (OSError, ValueError) as error:  # an ssl.SSLError is an OSError
            raise UsageMistake(
                f"{self.certificate.name} and {self.key.name} are not a matching certificate and key: "
                f"{error}",
                action="Give two PEM files; the key must have no password.",
            ) from error
        return context


def own_addresses() -> set[ipaddress.IPv4Address | ipaddress.IPv6Address]:
    """Return the addresses of this computer's network interfaces."""
    import psutil

    cards = psutil.net_if_addrs().values()
    addresses = (
        entry.address.partition("%")[0] for card in cards for entry in card if entry.family in FAMILIES
    )
    return {ipaddress.ip_address(address) for address in addresses}


def viewers_address(bind: str | None, certificate: Path | None, key: Path | None) -> ViewersAddress | None:
    """Build the viewers' address from the options, or return None without any. Raises CLI-001."""
    if bind is None:
        if certificate is not None or key is not None:
            given = " and ".join(
                option
                for option, file in (("--certificate", certificate), ("--key", key))
                if file is not None
            )
            raise UsageMistake(
                f"{given} belongs to the page at --bind",
                expected="--bind",
                action=f"Add --bind, or omit {given}.",
            )
        return None
    if certificate is None or key is None:
        raise UsageMistake(
            "--bind needs --certificate and --key: patient data is not sent unencrypted",
            action="Give both PEM files; openssl req -x509 -newkey makes a pair for tests.",
        )
    return ViewersAddress(bind, certificate, key)
