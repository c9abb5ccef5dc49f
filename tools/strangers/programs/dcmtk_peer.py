"""DCMTK: its archive dcmqrscp, and its senders echoscu, dcmsend, storescu."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from dicom_stand import HOST, dcmtk_archive, receiving, run_dcmtk
from our_dicom import FOLDER, PORT, SLICES, fetch, find, ours, series

from procedures.exchange.dicom_network.peers import TlsFiles


@contextmanager
def archive(*, holding: bool = True) -> Iterator[str]:
    """Run the archive, with a patient's series unless it holds nothing."""
    with dcmtk_archive(FOLDER, PORT) as port:
        if holding:
            sent = run_dcmtk("dcmsend", "-aec", "ARCHIVE", HOST, port, "--scan-directories", series())
            assert sent.returncode == 0, sent.stderr
        yield f"ARCHIVE@{HOST}:{port}"


def make_certificate() -> TlsFiles:
    certificate, key = FOLDER / "cert.pem", FOLDER / "key.pem"
    line = (
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "rsa:2048",
        "-nodes",
        "-days",
        "2",
        "-subj",
        "/CN=localhost",
    )
    subprocess.run([*line, "-keyout", key, "-out", certificate], check=True, capture_output=True)
    return TlsFiles(certificate, key, certificate)


def answers_our_echo() -> None:
    with archive(holding=False) as peer:
        ours("echo", peer)


def is_answered_by_our_receiver() -> None:
    with receiving(FOLDER / "inbox") as stand:
        assert run_dcmtk("echoscu", "-aec", "RONNA", HOST, stand.port).returncode == 0


def sends_a_series_to_our_receiver() -> None:
    with receiving(FOLDER / "inbox") as stand:
        run_dcmtk("dcmsend", "-aec", "RONNA", HOST, stand.port, "--scan-directories", series())
        assert len(stand.files()) == SLICES


def sends_a_series_to_our_receiver_by_tls() -> None:
    tls = make_certificate()
    files = ("+tls", tls.key, tls.certificate, "+cf", tls.authority)
    with receiving(FOLDER / "inbox", tls=tls) as stand:
        run_dcmtk("storescu", "-aec", "RONNA", HOST, stand.port, *files, "+sd", series())
        assert len(stand.files()) == SLICES


def lists_the_series_of_a_patient() -> None:
    with archive() as peer:
        assert len(find(peer)) == 1


def sends_a_series_that_we_fetch() -> None:
    with archive() as peer:
        assert fetch(peer)["complete"] is True


def stores_a_series_that_we_send() -> None:
    with archive(holding=False) as peer:
        ours("send", peer, series())
        assert len(find(peer)) == 1
