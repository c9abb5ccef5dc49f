"""Objects of a whole case sent to Orthanc: they lie in the CT's study, and nothing else is made."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from user_commands import Commands
from waiting import eventually

ORTHANC = shutil.which("Orthanc")
HOST = "127.0.0.1"
OBJECTS = {"FID": 2, "REG": 2, "RTSTRUCT": 1, "OT": 1, "SR": 1}  # series by modality, of export and check


@contextmanager
def orthanc(folder: Path) -> Iterator[str]:
    """An empty archive; yields the address of its REST interface."""
    assert ORTHANC is not None
    folder.mkdir()
    with socket.create_server((HOST, 0)) as free:
        port = free.getsockname()[1]
    on_loopback = {"DicomServerEnabled": False, "RemoteAccessAllowed": False, "HttpPort": port}
    config = folder / "orthanc.json"
    config.write_text(json.dumps({"StorageDirectory": str(folder), **on_loopback}))
    address = f"http://{HOST}:{port}"
    with (folder / "log").open("w") as log:
        process = subprocess.Popen([ORTHANC, str(config)], stdout=log, stderr=log)
        try:
            eventually(lambda: is_up(address))
            yield address
        finally:
            process.terminate()
            process.wait(30.0)


def is_up(address: str) -> bool:
    try:
        return bool(ask(address, "/system"))
    except OSError:
        return False


def ask(address: str, path: str, content: bytes | None = None) -> Any:
    with urllib.request.urlopen(f"{address}{path}", content, timeout=30.0) as answer:
        return json.load(answer)


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.skipif(ORTHANC is None, reason="proof by Orthanc not made: install Debian's orthanc")
def test_the_objects_of_a_case_lie_in_the_study_of_its_ct_and_make_no_other(
    commands: Commands, tmp_path: Path
) -> None:
    words = ("run", "--sim", "--scene", "mini", "--seed", "3", "--out", str(tmp_path / "runs"), "--json")
    run = tmp_path / "runs" / json.loads(commands.run("ronna-procedure", *words).stdout)["run"]
    ct, post = run / "case/ct", tmp_path / "post"
    commands.run("ronna-sim", "phantom", "--postoperative", str(run), "--out", str(post))
    check = ("postoperative", str(ct), str(post / "ct"), "--plan", str(run / "case/plan.toml"))
    into = ("--run", str(run), "--out", str(tmp_path / "proof"), "--identity")
    assert commands.run("ronna-ct", *check, *into).returncode == 0
    identity = ("--identity-from", str(ct), "--out", str(tmp_path / "export"))
    exported = commands.run("ronna-procedure", "export", str(run), *identity)
    assert exported.returncode == 0, exported.stderr
    assert "patient: Phantom^Head, identifier mini-3" in exported.stderr
    with orthanc(tmp_path / "orthanc") as archive:
        for path in sorted(ct.glob("*.dcm")):
            ask(archive, "/instances", path.read_bytes())
        (patient,), (study,) = ask(archive, "/patients"), ask(archive, "/studies")
        for folder in ("export", "proof"):
            for path in sorted((tmp_path / folder).glob("*.dcm")):
                ask(archive, "/instances", path.read_bytes())
        assert (ask(archive, "/patients"), ask(archive, "/studies")) == ([patient], [study])
        series = ask(archive, f"/studies/{study}/series")
        assert not ask(archive, f"/studies/{study}")["PatientMainDicomTags"].keys() - {
            *("PatientName", "PatientID", "PatientBirthDate", "PatientSex")
        }
    kinds = [one["MainDicomTags"]["Modality"] for one in series]
    assert {kind: kinds.count(kind) for kind in set(kinds)} == {"CT": 1, **OBJECTS}
