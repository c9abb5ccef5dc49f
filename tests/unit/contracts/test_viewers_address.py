"""The address for viewers at other computers: what is refused and what is warned about."""

from __future__ import annotations

import ipaddress
import subprocess
from pathlib import Path

import pytest

from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.viewers_address import WARNING, ViewersAddress, viewers_address


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("tls")
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    line = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    line += ["-days", "2", "-subj", "/CN=console", "-keyout", str(key), "-out", str(certificate)]
    subprocess.run(line, check=True, capture_output=True)
    key.chmod(0o600)
    return certificate, key


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("0.0.0.0", "all networks"),
        ("::", "all networks"),
        ("127.0.0.1", "the loopback address"),
        ("console.example", "not an address"),
        ("192.0.2.77", "not an address of this computer"),
    ],
)
def test_an_address_that_is_too_wide_or_not_of_this_computer_is_refused(
    pair: tuple[Path, Path], address: str, words: str
) -> None:
    with pytest.raises(UsageMistake, match=words):
        ViewersAddress(address, *pair).check()


@pytest.mark.parametrize("given", [{"bind": "10.0.0.1"}, {"certificate": Path("a")}, {"key": Path("b")}])
def test_an_address_without_certificate_and_key_or_the_reverse_is_refused(
    given: dict[str, object],
) -> None:
    with pytest.raises(UsageMistake, match="--bind"):
        viewers_address(**{"bind": None, "certificate": None, "key": None} | given)  # type: ignore[arg-type]  # by name


def test_a_certificate_and_key_that_do_not_match_are_refused(
    pair: tuple[Path, Path], tmp_path: Path, own: str
) -> None:
    (tmp_path / "other.pem").write_text("no certificate")
    for files in ((tmp_path / "other.pem", pair[1]), (pair[0], tmp_path / "nothing.pem")):
        with pytest.raises(UsageMistake, match="not a matching certificate and key"):
            ViewersAddress(own, *files).check()


def test_the_check_warns_about_patient_data_and_about_a_world_readable_key(
    pair: tuple[Path, Path], own: str
) -> None:
    assert ViewersAddress(own, *pair).check()[0] == WARNING
    pair[1].chmod(0o644)
    try:
        assert "chmod 600" in ViewersAddress(own, *pair).check()[-1]
    finally:
        pair[1].chmod(0o600)


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> str:
    """An address that counts as one of this computer's."""
    address = "192.168.1.20"
    own = {ipaddress.ip_address(address)}
    monkeypatch.setattr("ronna_hw.command_line.viewers_address.own_addresses", lambda: own)
    return address
