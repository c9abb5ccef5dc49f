"""A console that viewers on other computers reach by TLS, at an address of its own."""

from __future__ import annotations

import http.client
import ssl
import subprocess
from collections.abc import Iterator, Mapping
from urllib.parse import urlsplit

import pytest
from scripted_engine import served_at


@pytest.fixture(scope="module")
def addresses(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mapping[str, str]]:
    folder = tmp_path_factory.mktemp("served")
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    line = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    line += ["-days", "2", "-subj", "/CN=console", "-keyout", str(key), "-out", str(certificate)]
    subprocess.run(line, check=True, capture_output=True)
    with served_at(folder, "--viewers", "127.0.0.1", str(certificate), str(key)) as (_, addresses):
        yield addresses


def status_of(address: str, token: str) -> int:
    host, port = urlsplit(address).hostname, urlsplit(address).port
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    connection = http.client.HTTPSConnection(str(host), port, timeout=10, context=trusting)
    try:
        connection.request("GET", f"/?token={token}")
        return connection.getresponse().status
    finally:
        connection.close()


def test_the_page_for_other_computers_opens_with_the_viewer_key_only(addresses: Mapping[str, str]) -> None:
    remote = addresses["remote_viewer_url"]
    assert remote.startswith("https://127.0.0.1:")
    viewer, operator = (addresses[name].partition("token=")[2] for name in ("viewer_url", "url"))
    assert status_of(remote, viewer) == 303
    assert status_of(remote, operator) == 401


def test_an_unknown_path_is_answered_without_making_a_page_of_it(addresses: Mapping[str, str]) -> None:
    entrance = urlsplit(addresses["viewer_url"])
    connection = http.client.HTTPConnection(str(entrance.hostname), entrance.port, timeout=10)
    connection.request("GET", f"/?{entrance.query}")
    entered = connection.getresponse()
    entered.read()
    cookie = str(entered.getheader("set-cookie")).partition(";")[0]
    connection.request("GET", "/nothing-here", headers={"Cookie": cookie})
    answer = connection.getresponse()
    assert (answer.status, answer.read()) == (404, b"Not found.")
    connection.close()
