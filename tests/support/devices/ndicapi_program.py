"""A program around ndicapi, which keeps the interpreter to itself while it waits, on TCP for ever.

Run as a process of its own. It reads one JSON request per line and answers each with one line:
`{"do": "open", "endpoint": ...}`, `{"do": "command", "line": "INIT:"}`, `{"do": "load", "rom": ...}`,
`{"do": "track", "line": "BX:1801", "handles": [1], "frames": 500}`, `{"do": "reset"}`, `{"do": "close"}`.
What ndicapi raises is answered as `{"error": ...}`.
"""

from __future__ import annotations

import contextlib
import json
import sys
import time
from typing import Any

import ndicapy  # type: ignore[import-not-found]

PAUSE_S = 0.002  # after an old frame, so that whoever makes the frames is not starved


class Host:
    """One device of ndicapi."""

    def __init__(self) -> None:
        self._device: Any = None
        self._serial_path: str | None = None

    def open(self, endpoint: str, probe: bool = True) -> int | None:
        """Open a unit; a serial line is probed first. Answers what ndiProbe says, 0 when all is well."""
        if not endpoint.startswith("serial://"):
            self._device = ndicapy.ndiOpenNetwork("127.0.0.1", int(endpoint.rpartition(":")[2]))
            return None
        self._serial_path = endpoint.removeprefix("serial://")
        shown: int | None = ndicapy.ndiProbe(self._serial_path) if probe else None
        self._device = ndicapy.ndiOpen(self._serial_path)
        return shown

    def close(self) -> None:
        (ndicapy.ndiCloseNetwork if self._serial_path is None else ndicapy.ndiClose)(self._device)

    def reset(self) -> int:
        """A break on the line, and what the unit says to it."""
        ndicapy.ndiRESET(self._device)
        error: int = ndicapy.ndiGetError(self._device)
        return error

    def command(self, line: str) -> str:
        reply: str = ndicapy.ndiCommand(self._device, line)
        return reply

    def load(self, rom: str) -> list[Any]:
        """Give a definition a handle and enable it; answers the handle and what PINIT said."""
        self.command("PHRQ:*********1****")
        handle = ndicapy.ndiGetPHRQHandle(self._device)
        ndicapy.ndiPVWRFromFile(self._device, handle, rom)
        said = self.command(f"PINIT:{handle:02X}")
        self.command(f"PENA:{handle:02X}D")
        return [handle, said]

    def handles(self, line: str) -> list[int]:
        """The handles that a PHSR lists."""
        self.command(line)
        count = ndicapy.ndiGetPHSRNumberOfHandles(self._device)
        return [ndicapy.ndiGetPHSRHandle(self._device, index) for index in range(count)]

    def track(self, line: str, handles: list[int], frames: int) -> list[dict[str, Any]]:
        """Ask until that many different frames have been seen."""
        seen: list[dict[str, Any]] = []
        while len(seen) < frames:
            frame = self._frame(line, [bytes([handle]) for handle in handles])
            if not seen or seen[-1]["number"] != frame["number"]:
                seen.append(frame)
            else:
                time.sleep(PAUSE_S)
        return seen

    def _frame(self, line: str, handles: list[bytes]) -> dict[str, Any]:
        # ndicapi turns a binary reply into text, where it can, after it has read all values out of it.
        with contextlib.suppress(UnicodeDecodeError):
            ndicapy.ndiCommand(self._device, line)
        kind, device = line[:2], self._device
        numbers = {getattr(ndicapy, f"ndiGet{kind}Frame")(device, handle) for handle in handles}
        strays = getattr(ndicapy, f"ndiGet{kind}NumberOfPassiveStrays")(device)
        stray = getattr(ndicapy, f"ndiGet{kind}PassiveStray")
        return {
            "number": max(numbers),
            "one_frame": len(numbers) == 1,
            "tools": [getattr(ndicapy, f"ndiGet{kind}Transform")(device, handle) for handle in handles],
            "status": [getattr(ndicapy, f"ndiGet{kind}PortStatus")(device, handle) for handle in handles],
            "strays": [stray(device, index) for index in range(strays)],
            "system": getattr(ndicapy, f"ndiGet{kind}SystemStatus")(device),
        }


def main() -> None:
    host = Host()
    for request in map(json.loads, sys.stdin):
        action = getattr(host, request.pop("do"))
        try:
            answer: dict[str, Any] = {"answer": action(**request)}
        except OSError as error:
            answer = {"error": str(error)}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
