"""Clients of the tracker that we did not write, each in a process that a test can wait for, or kill."""

from __future__ import annotations

import json
import select
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Any, Self

NDICAPI_PROGRAM = Path(__file__).with_name("ndicapi_program.py")
SCIKIT_PROGRAM = Path(__file__).with_name("scikit_program.py")
ANSWER_LIMIT_S = 40.0  # host time; only a hang takes so long


class NdicapiError(Exception):
    """Error raised by ndicapi."""


class NdicapiHost:
    """Process at work with ndicapi."""

    def __init__(self, endpoint: str, *, probe: bool = True) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-P", str(NDICAPI_PROGRAM)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.serial = endpoint.startswith("serial://")
        self.probed = self.ask("open", endpoint=endpoint, probe=probe)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()

    def begin(self, action: str, **arguments: Any) -> None:
        """Begin a request; `answer` waits for it."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"do": action, **arguments}) + "\n")
        self.process.stdin.flush()

    def answer(self) -> Any:
        """Return the answer to the request begun before; raises NdicapiError."""
        output = self.process.stdout
        assert output is not None
        assert select.select([output], [], [], ANSWER_LIMIT_S)[0], "ndicapi hangs"
        line = output.readline()
        assert line, f"ndicapi died: {self.process.wait()}"
        said = json.loads(line)
        if "error" in said:
            raise NdicapiError(said["error"])
        return said["answer"]

    def ask(self, action: str, **arguments: Any) -> Any:
        self.begin(action, **arguments)
        return self.answer()

    def command(self, line: str) -> str:
        """Return the reply to one command, without its CRC."""
        reply: str = self.ask("command", line=line)
        return reply

    def load(self, *roms: Path) -> list[int]:
        """Load and enable definitions; every PINIT must have been carried out."""
        handles = []
        for rom in roms:
            handle, said = self.ask("load", rom=str(rom))
            assert said == "OKAY" or said.startswith("WARNING"), said
            handles.append(handle)
        return handles

    def track(self, line: str, handles: list[int], frames: int) -> list[dict[str, Any]]:
        """Return that many different frames."""
        seen: list[dict[str, Any]] = self.ask("track", line=line, handles=handles, frames=frames)
        return seen

    def kill(self) -> None:
        """End the process as a crash would: nothing is said to the unit."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()


def scikit_frames(configuration: dict[str, Any], frames: int) -> list[dict[str, Any]]:
    """Run a session of scikit-surgerynditracker; return the results of its `get_frame`."""
    done = subprocess.run(
        [sys.executable, "-P", str(SCIKIT_PROGRAM), json.dumps(configuration), str(frames)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=ANSWER_LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    shown: list[dict[str, Any]] = json.loads(done.stdout)
    return shown
