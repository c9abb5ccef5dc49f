"""Addresses of DICOM peers, AE titles, and TLS with certificates of both sides."""

from __future__ import annotations

import importlib.util
import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from procedures.exchange.dicom_network.errors import BAD_ADDRESS, NETWORK_MISSING, TLS_UNUSABLE

LONGEST_TITLE = 16  # PS3.5 6.2, AE
PORTS = range(1, 65_536)


def require_network() -> None:
    """Raise DCM-001 if the library for the network is not installed."""
    if importlib.util.find_spec("pynetdicom") is None:
        raise NETWORK_MISSING("the DICOM network needs pynetdicom, which is not installed")


def require_title(title: str) -> str:
    """Return an AE title without its outer spaces. Raises DCM-002 for what is none."""
    stripped = title.strip()
    if 0 < len(stripped) <= LONGEST_TITLE and all(" " <= one <= "~" and one != "\\" for one in stripped):
        return stripped
    raise BAD_ADDRESS(
        "an AE title is unusable", expected="1 to 16 printable ASCII characters, no backslash", got=title
    )


@dataclass(frozen=True)
class Peer:
    """DICOM application at another address."""

    title: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse `AETITLE@HOST:PORT`. Raises DCM-002."""
        title, at, place = text.rpartition("@")
        host, colon, port = place.rpartition(":")
        if not (at and colon and host and port.isascii() and port.isdigit() and int(port) in PORTS):
            raise BAD_ADDRESS("the address of a peer is unusable", expected="AETITLE@HOST:PORT", got=text)
        return cls(require_title(title), host.strip("[]"), int(port))

    def __str__(self) -> str:
        """Return it as it is typed."""
        return f"{self.title}@{self.host}:{self.port}"


@dataclass(frozen=True)
class TlsFiles:
    """Certificate and key of this computer, and the authority that signs the peers' certificates (PEM)."""

    certificate: Path
    key: Path
    authority: Path

    def server_context(self) -> ssl.SSLContext:
        """Return a context that admits only peers with a certificate of the authority. Raises DCM-004."""
        return self._fill(ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER))

    def client_context(self) -> ssl.SSLContext:
        """Return a context that accepts only servers with a certificate of the authority. Raises DCM-004."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname = False  # PS3.15 B: nodes are known by their certificates, not by names
        return self._fill(context)

    def _fill(self, context: ssl.SSLContext) -> ssl.SSLContext:
        context.minimum_version = ssl.TLSVersion.TLSv1_2  # PS3.15 B.9, BCP 195
        context.verify_mode = ssl.CERT_REQUIRED
        try:
            context.load_cert_chain(self.certificate, self.key)
            context.load_verify_locations(self.authority)
        except (OSError, ssl.SSLError) as problem:
            names = f"{self.certificate}, {self.key} and {self.authority}"
            raise TLS_UNUSABLE(f"TLS cannot use {names}", got=str(problem)) from problem
        return context
