"""The reference library of OpenIGTLink as a client: its program compiled, run, and what it has read."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import NamedTuple

SOURCE = Path(__file__).with_name("igtl_reference_client.cxx")
HEADERS = Path("/usr/include/openigtlink")
COMPILE_LIMIT_S, RUN_LIMIT_S = 120.0, 20.0  # host time
NOT_READ = "NOT READ"


class ReadMessage(NamedTuple):
    """A message as the library has read it; `words` are its content as text."""

    kind: str
    name: str
    stamp_s: float
    words: list[str]

    @property
    def is_read(self) -> bool:
        """Whether the library has accepted it."""
        return " ".join(self.words[-2:]) != NOT_READ


def compile_reference_client(folder: Path) -> Path:
    """Compile the client."""
    program = folder / "client"
    line = ["g++", f"-I{HEADERS}", str(SOURCE), "-o", str(program), "-lOpenIGTLink", "-lpthread"]
    done = subprocess.run(line, timeout=COMPILE_LIMIT_S, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return program


def read_by_reference_client(program: Path, port: int, *kinds: str) -> tuple[int, list[ReadMessage]]:
    """Read until a message of each type has come; return code 3 says that the server ended before."""
    line = [str(program), str(port), *kinds]
    run = subprocess.run(line, timeout=RUN_LIMIT_S, capture_output=True, text=True)
    rows = [text.split("|", 3) for text in run.stdout.splitlines()]
    return run.returncode, [
        ReadMessage(kind, name, float(stamp), text.split()) for kind, name, stamp, text in rows
    ]
