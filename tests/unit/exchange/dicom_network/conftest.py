from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from procedures.exchange.dicom_network.peers import TlsFiles


@pytest.fixture
def make_tls(tmp_path: Path) -> Callable[[], TlsFiles]:
    """Makes a certificate that is its own authority, for both sides."""
    if shutil.which("openssl") is None:
        pytest.skip("proof not made: install openssl")

    def make() -> TlsFiles:
        certificate, key = tmp_path / "cert.pem", tmp_path / "key.pem"
        subject = ("-subj", "/CN=localhost", "-days", "2")
        line = ("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", *subject)
        subprocess.run([*line, "-keyout", key, "-out", certificate], check=True, capture_output=True)
        return TlsFiles(certificate, key, certificate)

    return make
