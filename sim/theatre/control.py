"""The control port: the only access of the scripted operator to the simulated room.

JSON lines over TCP on loopback, one answer per request: `{"do": "step", "name": "..."}`,
`{"do": "mount", "number": 2}`, `{"do": "fault", "line": "now: ..."}`, `{"do": "clear_faults"}`. Naming the
step `at_target:<id>` samples the truth at that target. A theatre has one port, and so has each simulator that
was started alone.
"""

from __future__ import annotations

import contextlib
import json
import socketserver
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ronna_hw.errors import RonnaError
from sim.theatre.faults import begin_now, check_faults, parse_faults
from sim.theatre.left_world import write_left_world
from sim.theatre.truth import append_sample, sample_tip
from sim.theatre.world import World

AT_TARGET = "at_target:"
LONGEST_REQUEST = 64 * 1024


class Room:
    """What the operator can do in the room. Truth at a target is kept in `folder`, where there is one."""

    def __init__(self, world: World, folder: Path | None) -> None:
        self._world = world
        self._folder = folder

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out one request; an unknown or wrong one is answered with the reason."""
        actions: dict[str, Callable[[dict[str, Any]], None]] = {
            "step": self._step,
            "mount": self._mount,
            "fault": self._fault,
            "clear_faults": self._clear_faults,
        }
        action = actions.get(str(request.get("do")))
        if action is None:
            return {"ok": False, "reason": f"unknown request; known: {', '.join(actions)}"}
        try:
            action(request)
        except RonnaError as error:
            return {"ok": False, "reason": f"{error.code}: {error.what}"}
        except (KeyError, TypeError, ValueError) as error:
            return {"ok": False, "reason": f"bad request: {error!r}"}
        return {"ok": True, "theatre_time_s": self._world.clock.now_s()}

    def _step(self, request: dict[str, Any]) -> None:
        name = str(request["name"])
        self._world.enter_step(name)
        if name.startswith(AT_TARGET) and self._folder is not None:
            append_sample(sample_tip(self._world, name.removeprefix(AT_TARGET)), self._folder)

    def _mount(self, request: dict[str, Any]) -> None:
        number = int(request["number"])
        mount = self._world.scene.mount
        if number not in (0, mount.tool_number_stereo, mount.tool_number_guide):
            raise ValueError(
                f"expected tool 0, {mount.tool_number_stereo} or {mount.tool_number_guide}, got {number}"
            )
        self._world.mount_tool(number)
        if self._folder is not None:
            write_left_world(self._world, self._folder)

    def _fault(self, request: dict[str, Any]) -> None:
        line = str(request["line"])
        _, text = self._world.fault_script()
        check_faults(parse_faults(line), self._world.scene)
        line = begin_now(line, self._world.clock.now_s())
        self._world.set_fault_script(f"{text}\n{line}" if text else line)

    def _clear_faults(self, _request: dict[str, Any]) -> None:
        self._world.set_fault_script("")


class ControlPort:
    """Serves the room on a free loopback port until closed."""

    def __init__(self, room: Room) -> None:
        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                with contextlib.suppress(OSError):  # the operator went away without a farewell
                    while line := self.rfile.readline(LONGEST_REQUEST):
                        try:
                            request = json.loads(line)
                        except ValueError:
                            request = {}
                        answer = room.answer(request if isinstance(request, dict) else {})
                        self.wfile.write(json.dumps(answer).encode() + b"\n")

        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = True
            block_on_close = False

        self._server = Server(("127.0.0.1", 0), Handler)
        threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()

    @property
    def endpoint(self) -> str:
        """Where the operator connects."""
        return f"tcp://127.0.0.1:{self._server.server_address[1]}"

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
