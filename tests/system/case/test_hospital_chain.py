"""A rehearsal in a hospital network: CT from an archive, poses to a viewer, results into its study."""

from __future__ import annotations

import json
import socket
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dicom_stand import free_port, needs_orthanc, orthanc
from user_commands import Commands

from procedures.exchange.run_export import INDEX

POSE = "ToolToRas"
SEED = "3"
STORED = {"CT": 1, "FID": 1, "REG": 1, "RTSTRUCT": 1, "OT": 1}  # series by modality


def read_pose(port: int, seen: list[Any], ended: threading.Event) -> None:
    """Read one pose as soon as the server listens: a client that is refused would go on trying at once."""
    pyigtl = pytest.importorskip("pyigtl")
    while not is_served(port):
        if ended.wait(0.2):
            return
    client = pyigtl.OpenIGTLinkClient("127.0.0.1", port)
    while not (seen or ended.is_set()):
        if (message := client.wait_for_message(POSE, 1.0)) is not None:
            seen.append(message)
    client.stop()


def is_served(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@needs_orthanc
@pytest.mark.slow
@pytest.mark.timeout(600)  # only ends what hangs
def test_one_command_takes_the_ct_from_an_archive_and_stores_the_results_in_its_study(
    commands: Commands, tmp_path: Path
) -> None:
    ours, link, seen, ended = free_port(), free_port(), list[Any](), threading.Event()
    reader = threading.Thread(target=read_pose, args=(link, seen, ended), daemon=True)
    with orthanc(tmp_path / "orthanc", ours) as archive:
        reader.start()
        through = ("--archive", f"ORTHANC@127.0.0.1:{archive.port}", "--archive-port", str(ours))
        poses = ("--openigtlink", f"127.0.0.1:{link}")
        case = ("run", "--sim", "--scene", "mini", "--seed", SEED, "--out", str(tmp_path / "runs"), "--json")
        done = commands.run("ronna-procedure", *case, *through, *poses)
        ended.set()
        assert done.returncode == 0, done.stderr
        assert len(archive.get("/patients")) == len(archive.get("/studies")) == 1
        series = [archive.get(f"/series/{one}")["MainDicomTags"] for one in archive.get("/series")]
    found = [one["Modality"] for one in series]
    assert {modality: found.count(modality) for modality in found} == STORED
    run = tmp_path / "runs" / json.loads(done.stdout)["run"]
    assert not (run / "export" / INDEX).exists(), "a run folder holds no identity"
    reader.join(10.0)
    assert seen, f"no {POSE} has come"
    assert np.allclose(np.linalg.det(seen[0].matrix[:3, :3]), 1.0, atol=1e-5)
