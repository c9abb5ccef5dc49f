"""Run every stranger that is installed here against every case, and keep what was found: `make strangers`.

Results of strangers that are not installed stay as they are. tools/docs/generate.py makes the page of them.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import shorten

import tomli_w

ROOT = Path(__file__).resolve().parents[2]
sys.path += [str(Path(__file__).parent), str(ROOT / "tools" / "docs")]

from run_case import MARK  # noqa: E402
from stranger_cases import GIGE_VISION, POLARIS, Case  # noqa: E402
from stranger_catalogue import CLIENTS, SERVERS, Client, Server  # noqa: E402
from strangers_table import PASSES, RESULTS, Result, read_results  # noqa: E402

from sim.polaris.unit.tool_definition import write_definition  # noqa: E402
from sim.simulators import running  # noqa: E402
from sim.world.scene.model import TrackerTool  # noqa: E402
from sim.world.scene.named_scenes import draw_scene, robot_frame  # noqa: E402

LIMIT_S = 30.0  # host time, of a case; most take one
SUITE_LIMIT_S = 300.0
FAILURE_WORDS = 200  # characters of a failure that are kept
ONE_ROOM = ("unshare", "--net", "--map-root-user")
# Planar tools whose 12 segments differ by 3 mm and more.
TOOLS = (
    robot_frame(),
    TrackerTool(
        name="pointer",
        part_number="8700340",
        markers_mm=((0.0, 0.0, 0.0), (0.0, 50.0, 0.0), (25.0, 100.0, 0.0), (-25.0, 135.0, 0.0)),
    ),
    TrackerTool(
        name="probe",
        part_number="PROBE",
        markers_mm=((0.0, 0.0, 0.0), (0.0, 95.0, 0.0), (59.0, 38.0, 0.0), (-46.0, 119.0, 0.0)),
    ),
)


def run_client(client: Client, version: str, folder: Path, only: Iterable[str] = ()) -> Result:
    """Run the cases that a client is asked, each with a fresh simulator, or only those that are named."""
    asked = client.sources()
    cases = [one for one in client.protocol.cases if one.name in asked and (not only or one.name in only)]
    return Result(
        client.name,
        version,
        client.protocol.title,
        {one.name: _run_case(client, one, folder) for one in cases},
    )


def _run_case(client: Client, case: Case, folder: Path) -> str:
    """Return `passes`, or the failure in a line."""
    with _simulated(client, case, folder) as variables:
        command = (client.python, "-P", "-W", "ignore", Path(__file__).with_name("run_case.py"), client.path)
        try:
            done = subprocess.run(
                (*command, case.name),
                env={**os.environ, **variables},
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=LIMIT_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return f"does not end within {LIMIT_S:g} s"
    if done.returncode < 0:
        return f"killed by {signal.Signals(-done.returncode).name}"
    if done.returncode == 0:
        return PASSES
    said = [line for line in done.stdout.splitlines() if line.startswith(MARK)] or [f"{MARK}no word"]
    return said[-1].removeprefix(MARK)[:FAILURE_WORDS]


@contextmanager
def _simulated(client: Client, case: Case, folder: Path) -> Iterator[dict[str, str]]:
    """Yield the environment of a case while its simulator runs."""
    paths = (ROOT, *sorted((ROOT / "tests" / "support").iterdir()))
    variables = {"PYTHONPATH": os.pathsep.join(map(str, paths))}
    if client.protocol is POLARIS:
        variables["ROMS"] = os.pathsep.join(map(str, _definitions(folder)))
        variables["PATH"] = f"{_ping(folder)}{os.pathsep}{os.environ['PATH']}"
    if not client.protocol.simulator:
        yield variables
        return
    kind, *options = client.protocol.simulator
    scene = str(_scene_with_own_cameras(folder)) if client.protocol is GIGE_VISION else None
    with running(kind, (*options, *client.options(), *case.options), scene, lambda: folder) as simulator:
        yield {**variables, **simulator.variables}


def _scene_with_own_cameras(folder: Path) -> Path:
    """Write a scene whose cameras no other simulator has: some clients tell them apart by serial number."""
    scene = draw_scene("bench")
    number = os.getpid() % 100_000
    sides = {"left": f"31{number:05d}1", "right": f"31{number:05d}2"}
    cameras = {
        side: getattr(scene, side).model_copy(update={"serial": serial}) for side, serial in sides.items()
    }
    file = folder / "scene.toml"
    content = scene.model_copy(update=cameras).model_dump(mode="json", by_alias=True, exclude_none=True)
    file.write_text(tomli_w.dumps(content), encoding="utf-8")
    return file


def _definitions(folder: Path) -> list[Path]:
    files = [folder / f"{tool.name}.rom" for tool in TOOLS]
    for file, tool in zip(files, TOOLS, strict=True):
        file.write_bytes(write_definition(tool))
    return files


def _ping(folder: Path) -> Path:
    """Return a folder with a `ping` for scikit-surgerynditracker: not every computer has that program."""
    (folder / "bin").mkdir(exist_ok=True)
    ping = folder / "bin" / "ping"
    ping.write_text("#!/bin/sh\nexit 0\n")
    ping.chmod(0o755)
    return ping.parent


def run_server(server: Server, version: str) -> Result | None:
    """Run our suite against a foreign device; None where no network namespace is allowed."""
    if subprocess.run((*ONE_ROOM, "ip", "link"), capture_output=True, check=False).returncode:
        return None
    suite = Path(sys.executable).with_name("ronna-conformance")
    ended = subprocess.run(
        (*ONE_ROOM, "bash", "-c", server.script, suite),
        capture_output=True,
        text=True,
        timeout=SUITE_LIMIT_S,
        check=True,
    )
    cases = {
        case["number"]: PASSES
        if case["outcome"] == "PASS"
        else shorten(str(case["reason"]), FAILURE_WORDS, placeholder=" …")
        for case in json.loads(ended.stdout)["cases"]
        if case["outcome"] != "SKIP"
    }
    return Result(server.name, version, server.protocol.title, cases)


def run(stranger: Client | Server) -> tuple[str, Result | None]:
    """Run a stranger; return a word on it, and what was found unless it cannot run here."""
    version = stranger.version()
    if version is None:
        return "not installed, its rows stay as they are", None
    found: Result | None
    if isinstance(stranger, Server):
        found = run_server(stranger, version)
    else:
        with tempfile.TemporaryDirectory(prefix="ronna-strangers-") as folder:
            found = run_client(stranger, version, Path(folder))
    if found is None:
        return "left out, this computer allows no network namespace", None
    passed = sum(outcome == PASSES for outcome in found.cases.values())
    return f"{passed} of {len(found.cases)} cases pass with {version}", found


def main() -> None:
    """Run what is installed, or the strangers that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="STRANGER", help="strangers to run; by default all")
    names = parser.parse_args().names
    results = {one.name: one for one in read_results()}
    for stranger in (*CLIENTS, *SERVERS):
        if not names or stranger.name in names:
            said, found = run(stranger)
            sys.stdout.write(f"{stranger.name}: {said}\n")
            sys.stdout.flush()
            results |= {stranger.name: found} if found else {}
    order = [one.name for one in (*CLIENTS, *SERVERS)]
    kept = [results[name].as_table() for name in order if name in results]
    RESULTS.write_text(tomli_w.dumps({"stranger": kept}), encoding="utf-8")


if __name__ == "__main__":
    main()
