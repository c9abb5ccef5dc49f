"""Strangers: clients and servers of others, each with its program or suite. One more is one more entry.

A client's program has a function for each case that it is asked; `stranger_cases` says which there are.
"""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from stranger_cases import (
    DICOM_NETWORK,
    DICOM_OBJECTS,
    FLIGHT_LOG,
    GIGE_VISION,
    ITK_TRANSFORM,
    KUKA_RSI,
    OPENIGTLINK,
    POLARIS,
    UR,
    Protocol,
)

from conformance.case import Suite
from conformance.stereo import SUITE

PROGRAMS = Path(__file__).with_name("programs")
SYSTEM_PYTHON = "/usr/bin/python3"  # has Aravis' bindings
VERSION_LIMIT_S = 20.0


def installed(package: str) -> Callable[[], str | None]:
    """Return a function that gives the version of a Python package, None without it."""

    def version() -> str | None:
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            return None

    return version


def printed(*command: str) -> Callable[[], str | None]:
    """Return a function that gives the first number with a dot that a program prints, None without it."""

    def version() -> str | None:
        if shutil.which(command[0]) is None:
            return None
        said = subprocess.run(command, capture_output=True, text=True, timeout=VERSION_LIMIT_S, check=False)
        words = [word.removeprefix("v") for word in f"{said.stdout} {said.stderr}".replace("(", " ").split()]
        return next((word.strip(".,)") for word in words if word[:1].isdigit() and "." in word), None)

    return version


def no_options() -> Sequence[str]:
    """Return no further options of the simulator."""
    return ()


@dataclass(frozen=True)
class Client:
    """Client of others, with the file of its program, and how its version is found.

    `options` are further ones of the simulator, `reports` the issues of its project on a case.
    """

    name: str
    protocol: Protocol
    program: str
    version: Callable[[], str | None]
    options: Callable[[], Sequence[str]] = no_options
    python: str = sys.executable
    reports: Mapping[str, str] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        """Path of the program."""
        return PROGRAMS / self.program

    def sources(self) -> dict[str, str]:
        """Return the text of each function of the program by its name; a case without one is not asked."""
        text = self.path.read_text(encoding="utf-8")
        return {
            node.name: ast.get_source_segment(text, node) or ""
            for node in ast.parse(text).body
            if isinstance(node, ast.FunctionDef)
        }


def _rsipi_context() -> Sequence[str]:
    found = find_spec("RSIPI")
    assert found is not None
    assert found.origin is not None
    return ("--rsi-config", os.fspath(Path(found.origin).parent / "contexts/RSI_EthernetConfig_Joints.xml"))


def _library_to_compile() -> str | None:
    """Return the version of Debian's libopenigtlink-dev, None without it or a compiler."""
    return printed("dpkg-query", "-W", "libopenigtlink-dev")() if shutil.which("g++") else None


HIDDEN, BINARY = "says_that_a_tool_is_hidden", "reads_three_tools_as_binary"
CLIENTS = (
    Client(
        "ndicapi",
        POLARIS,
        "ndicapi_client.py",
        installed("ndicapi"),
        reports={
            HIDDEN: "PlusToolkit/ndicapi#47",
            BINARY: "SciKit-Surgery/scikit-surgerynditracker#67",
        },
    ),
    Client(
        "scikit-surgerynditracker",
        POLARIS,
        "scikit_client.py",
        installed("scikit-surgerynditracker"),
        reports={BINARY: "SciKit-Surgery/scikit-surgerynditracker#67"},
    ),
    Client("RSIPI", KUKA_RSI, "rsipi_client.py", installed("RSIPI"), _rsipi_context),
    Client("ur-rtde", UR, "ur_rtde_client.py", installed("ur-rtde")),
    Client(
        "urx",
        UR,
        "urx_client.py",
        installed("urx"),
        lambda: ("--model", "ur5", "--set", "robot_mode_bytes=46"),
    ),
    Client(
        "Aravis",
        GIGE_VISION,
        "aravis_client.py",
        printed("arv-tool-0.8", "--version"),
        python=SYSTEM_PYTHON,
    ),
    Client("tshark", GIGE_VISION, "tshark_reader.py", printed("tshark", "--version")),
    Client(
        "pyigtl",
        OPENIGTLINK,
        "pyigtl_client.py",
        installed("pyigtl"),
        reports=dict.fromkeys(("reads_a_status", "reads_a_trajectory"), "lassoan/pyigtl#13"),
    ),
    Client("libOpenIGTLink", OPENIGTLINK, "igtl_library_client.py", _library_to_compile),
    Client("DCMTK", DICOM_NETWORK, "dcmtk_peer.py", printed("dcmdump", "--version")),
    Client("Orthanc", DICOM_NETWORK, "orthanc_peer.py", printed("Orthanc", "--version")),
    Client("dciodvfy", DICOM_OBJECTS, "dciodvfy_validator.py", printed("dciodvfy", "-version")),
    Client("SimpleITK", ITK_TRANSFORM, "itk_reader.py", installed("simpleitk")),
    Client("rosbags", FLIGHT_LOG, "rosbags_reader.py", installed("rosbags")),
    Client("mcap", FLIGHT_LOG, "mcap_reader.py", installed("mcap")),
)


@dataclass(frozen=True)
class Server:
    """Device of others, against which our conformance suite runs with our driver."""

    name: str
    protocol: Protocol
    suite: Suite
    version: Callable[[], str | None]
    script: str  # for bash in a network namespace of its own; $0 is the suite, whose report it prints


# Each fake camera wants an address that an interface has.
TWO_FAKE_CAMERAS = """
set -e
ip link set lo up
ip address add 10.9.0.1/24 dev lo
ip address add 10.9.1.1/24 dev lo
arv-fake-gv-camera-0.8 -i 10.9.0.1 -s STRANGER01 & arv-fake-gv-camera-0.8 -i 10.9.1.1 -s STRANGER02 &
trap 'kill $(jobs -p)' EXIT
until [ "$(ss -Hlun 'src 10.9.0.0/16 and sport = 3956' | wc -l)" = 2 ]; do sleep 0.1; done
"$0" stereo --only S --json --endpoint left=gev://10.9.0.1 --endpoint right=gev://10.9.1.1 || true
"""
ARAVIS_CAMERAS = Server(
    "Aravis' fake cameras",
    GIGE_VISION,
    SUITE,
    printed("arv-tool-0.8", "--version"),
    TWO_FAKE_CAMERAS,
)
SERVERS = (ARAVIS_CAMERAS,)
