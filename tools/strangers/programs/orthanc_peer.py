"""Orthanc as an archive: asked by us, and told by its REST interface to send."""

from __future__ import annotations

import json
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager

from dicom_stand import HOST, Orthanc, orthanc, receiving
from our_dicom import FOLDER, PORT, SLICES, fetch, find, ours, series
from prepared_results import SERIES
from whole_run import whole_run

from procedures.exchange.run_export import export_run

LIMIT_S = 20.0


@contextmanager
def archive(ours_at: int = PORT) -> Iterator[tuple[Orthanc, str]]:
    """Run Orthanc; it knows us as RONNA at a port."""
    with orthanc(FOLDER / "orthanc", ours_at) as one:
        yield one, f"ORTHANC@{HOST}:{one.port}"


def tell(one: Orthanc, path: str, content: object) -> None:
    request = urllib.request.Request(f"{one.address}{path}", json.dumps(content).encode())
    with urllib.request.urlopen(request, timeout=LIMIT_S) as answer:
        assert answer.status == 200


def answers_our_echo() -> None:
    with archive() as (_, peer):
        ours("echo", peer)


def is_answered_by_our_receiver() -> None:
    with receiving(FOLDER / "inbox") as stand, archive(stand.port) as (one, _):
        tell(one, "/modalities/ronna/echo", {})


def sends_a_series_to_our_receiver() -> None:
    with receiving(FOLDER / "inbox") as stand, archive(stand.port) as (one, peer):
        ours("send", peer, series())
        tell(one, "/modalities/ronna/store", one.get("/series"))
        assert len(stand.files()) == SLICES


def lists_the_series_of_a_patient() -> None:
    with archive() as (_, peer):
        ours("send", peer, series())
        assert find(peer)[0]["instances"] == str(SLICES)


def sends_a_series_that_we_fetch() -> None:
    with archive() as (_, peer):
        ours("send", peer, series())
        assert fetch(peer)["complete"] is True


def stores_a_series_that_we_send() -> None:
    with archive() as (one, peer):
        ours("send", peer, series())
        assert len(one.get("/instances")) == SLICES


def files_the_results_of_a_run_in_the_study_of_its_ct() -> None:
    ct, out = series(SeriesInstanceUID=SERIES), FOLDER / "export"
    export_run(whole_run(FOLDER / "run"), out, identity_from=ct)
    with archive() as (one, peer):
        for folder in (ct, out):
            ours("send", peer, folder)
        assert (len(one.get("/patients")), len(one.get("/studies"))) == (1, 1)
        assert len(one.get("/series")) > 1
