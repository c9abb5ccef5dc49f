"""Control port: JSON lines over TCP on loopback, the only way for staff to act on the simulated room.

A theatre has one, and so does each simulator started alone. Any process on this computer can connect, even a
page in a browser, so a connection is trusted only if its first line is `{"token": "..."}` with the token from
the READY line. It is closed at the first line that is too long or no JSON object, and when no line arrives
for a while. Connections without the token cannot keep out those with it.

Each further line is a request, with one answer:
- `{"do": "identify"}`, answered with `identity`, as in the theatre file, and `folder`, both empty for a
  simulator alone;
- `{"do": "step", "name": "..."}`, `{"do": "mount", "number": 2}`, `{"do": "stand", "holds": "divot"}`;
- `{"do": "fault", "line": "now: ..."}`;
- `{"do": "clear_faults"}`, with a `line` only that fault;
- `{"do": "missed_faults"}`, answered with `missed`: faults that began too late to have an effect, and why;
- `{"do": "move", "cart": 1, "by_mm": [60, -40, 0], "turn_deg": 5}`, answered once the cart has arrived; with
  `"anyway": true` also if an instrument is in the guide;
- `{"do": "work", "task": "insert", "trajectory": "T1", "numbers": []}`, answered with `readings`;
  inserting an instrument samples the truth at that target;
- `{"do": "wristband"}`, answered with `wristband`: the identifier that the patient wears.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import math
import secrets
import socket
import socketserver
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ronna_hw.bounded_input import parse_json
from ronna_hw.control_port import LONGEST_LINE, TOKEN_KEY, ControlAddress
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.phantom_identity import format_patient_id
from ronna_hw.text import printable
from ronna_hw.wire.room_tasks import DEPTH_STOP, OnStand
from sim.errors import INSTRUMENT_IN_GUIDE
from sim.world.carts import CartDisplacement
from sim.world.faults import (
    FaultBoard,
    begin_now,
    begin_with_step,
    check_faults,
    devices_of,
    parse_faults,
    parse_request,
    without_fault,
)
from sim.world.faults.board import format_beginning
from sim.world.faults.fault import Fault
from sim.world.faults.room import DEVICE, MISSED_TASK, MOVE, WRONG_STOP, WRONG_TOOL, tool_numbers
from sim.world.faults.tracker import name_tool
from sim.world.saved_world import save_world
from sim.world.staff import Staff, TaskRefused
from sim.world.world import World

TAKES_S = "takes_s"  # theatre time from a request to its answer
QUERIES = ("identify", "missed_faults", "wristband", "truth")  # requests that change nothing in the room
LONGEST_REASON = 500  # characters: it may quote the request
MOST_MISSED = 20  # faults listed in one answer

TOKEN_BYTES = 16  # from the system's random source: unguessable
MOST_CONNECTIONS = 8
FIRST_LINE_LIMIT_S = 2.0  # host time, from the connection to the complete first line
IDLE_LIMIT_S = 10.0  # host time, from one line to the complete next one
NO_TOKEN = {"ok": False, "reason": "expected the token from the READY line in the first line"}


class ControlPort:
    """Control port of a room, open on a free loopback port until closed."""

    def __init__(
        self,
        room: ControlledRoom,
        *,
        first_line_limit_s: float = FIRST_LINE_LIMIT_S,
        idle_limit_s: float = IDLE_LIMIT_S,
    ) -> None:
        limits_s = (first_line_limit_s, idle_limit_s)
        self._server = _Server(room, secrets.token_urlsafe(TOKEN_BYTES), limits_s)
        threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()

    @property
    def endpoint(self) -> str:
        """Address including the access token, so it must be kept secret."""
        address = Endpoint("tcp", "127.0.0.1", self._server.server_address[1])
        return ControlAddress(address, self._server.token).text()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, room: ControlledRoom, token: str, limits_s: tuple[float, float]) -> None:
        super().__init__(("127.0.0.1", 0), _Conversation)
        self.room = room
        self.token = token
        self.limits_s = limits_s
        self.untrusted: list[socket.socket] = []  # token not received yet, oldest first
        self.trusted: list[socket.socket] = []
        self.changing = threading.Lock()

    def verify_request(self, request: socket.socket | tuple[bytes, socket.socket], _address: Any) -> bool:
        """Admit a connection, dropping the oldest untrusted one if there are too many."""
        assert isinstance(request, socket.socket)
        with self.changing:
            if len(self.trusted) == MOST_CONNECTIONS:
                return False
            if len(self.untrusted) + len(self.trusted) == MOST_CONNECTIONS:
                with contextlib.suppress(OSError):
                    self.untrusted.pop(0).shutdown(socket.SHUT_RDWR)
            self.untrusted.append(request)
        return True


class _Conversation(socketserver.BaseRequestHandler):
    request: socket.socket
    server: _Server

    def handle(self) -> None:
        self._received = b""
        with contextlib.suppress(OSError, _HangUp):  # the client disconnected abruptly
            first_line_limit_s, idle_limit_s = self.server.limits_s
            token = self._receive_next(first_line_limit_s).get(TOKEN_KEY)
            if not hmac.compare_digest(str(token).encode(errors="replace"), self.server.token.encode()):
                self._answer(NO_TOKEN)
                return
            self._trust()
            self._answer({"ok": True})
            while True:
                self._answer(self.server.room.answer(self._receive_next(idle_limit_s)))

    def finish(self) -> None:
        with self.server.changing:
            for sockets in (self.server.untrusted, self.server.trusted):
                if self.request in sockets:
                    sockets.remove(self.request)

    def _trust(self) -> None:
        with self.server.changing:
            if self.request not in self.server.untrusted:
                raise _HangUp  # dropped a moment ago
            self.server.untrusted.remove(self.request)
            self.server.trusted.append(self.request)

    def _receive_next(self, limit_s: float) -> dict[str, Any]:
        """Receive the next JSON object, hanging up on anything else or after `limit_s`."""
        deadline = time.monotonic() + limit_s
        while b"\n" not in self._received:
            self.request.settimeout(max(deadline - time.monotonic(), 0.001))
            more = self.request.recv(LONGEST_LINE)
            if not more or len(self._received) > LONGEST_LINE or time.monotonic() > deadline:
                raise _HangUp
            self._received += more
        line, _, self._received = self._received.partition(b"\n")
        try:
            request = parse_json(line, LONGEST_LINE)
        except ValueError:
            raise _HangUp from None
        if not isinstance(request, dict):
            raise _HangUp
        return request

    def _answer(self, answer: dict[str, Any]) -> None:
        self.request.settimeout(self.server.limits_s[1])
        self.request.sendall(json.dumps(answer).encode() + b"\n")


class _HangUp(Exception):
    """The connection must be closed."""


class ControlledRoom:
    """Executes requests in a world, and stores the truth at each target in `folder` if given.

    `devices` are simulated here, by default all: faults of others are refused. `loaded` returns the tools
    that a client has loaded into the tracker, if the tracker is in this process.
    """

    def __init__(
        self,
        world: World,
        folder: Path | None,
        devices: Sequence[str] | None = None,
        loaded: Callable[[], Sequence[str]] | None = None,
        identity: str = "",
        truth: Callable[[], dict[str, Any]] | None = None,
    ) -> None:
        """Serve a world; with `truth`, its truth too."""
        self._world, self._truth = world, truth
        self._folder = folder
        self._identity = identity
        self._devices = devices_of(world.scene) if devices is None else devices
        self._loaded = loaded
        self._staff = Staff(world, folder)
        self._board = FaultBoard(world, DEVICE)
        self._opened_s = round(world.clock.now_s(), 9)  # as a script states it
        self._steps: list[tuple[float, str]] = []  # begun so far, with their theatre time
        self._acted: list[Fault] = []  # of the kinds that act only in a task
        self._one_at_a_time = threading.Lock()  # requests may come from several connections

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Execute a request, answering an unknown or invalid one with the reason."""
        actions: dict[str, Callable[[dict[str, Any]], dict[str, Any] | None]] = {
            "identify": self._identify,
            "step": self._step,
            "work": self._work,
            "mount": self._mount,
            "stand": self._stand,
            "move": self._move,
            "fault": self._fault,
            "clear_faults": self._clear_faults,
            "missed_faults": self._list_missed_faults,
            "wristband": self._read_wristband,
            "truth": self._tell_truth,
        }
        action = actions.get(str(request.get("do")))
        if action is None:
            return {"ok": False, "reason": f"unknown request; known: {', '.join(actions)}"}
        try:
            with self._one_at_a_time:
                more = action(request) or {}
                if self._folder is not None and request["do"] not in QUERIES:
                    with contextlib.suppress(OSError):  # a full disk must not stop the staff
                        save_world(self._world, self._folder)
            self._world.clock.sleep(more.pop(TAKES_S, 0.0))  # meanwhile, others may ask
        except TaskRefused as error:
            return _refusal(error, error.advice)
        except RonnaError as error:
            return {
                "ok": False,
                "reason": f"{error.code}: {error.summary}"[:LONGEST_REASON],
                "advice": error.advice[:LONGEST_REASON],
            }
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            return {"ok": False, "reason": f"bad request: {error!r}"[:LONGEST_REASON]}
        except Exception as error:  # a defect of ours: an answer says more than a closed connection
            traceback.print_exc()
            return _refusal(f"the simulator failed: {error!r}", "Report this with the output of the theatre.")
        return {"ok": True, "theatre_time_s": self._world.clock.now_s(), **more}

    def _identify(self, _request: dict[str, Any]) -> dict[str, Any]:
        folder = "" if self._folder is None else str(self._folder.resolve())
        return {"identity": self._identity, "folder": folder}

    def _step(self, request: dict[str, Any]) -> None:
        name = str(request["name"])
        _, text = self._world.fault_script()
        now_s = self._world.clock.now_s()
        started = begin_with_step(text, name, now_s)
        self._steps.append((round(now_s, 9), name))
        if started != text:
            self._world.set_fault_script(started)
        self._world.enter_step(name)

    def _work(self, request: dict[str, Any]) -> dict[str, Any]:
        numbers = [_require_number(value) for value in request.get("numbers", ())]
        if request["task"] == DEPTH_STOP:
            self._acted += self._board.active(WRONG_STOP.name)
        readings = self._staff.work(str(request["task"]), str(request.get("trajectory", "")), numbers)
        return {"readings": list(readings)}

    def _mount(self, request: dict[str, Any]) -> None:
        number = _require_number(request["number"])
        if number not in (known := tool_numbers(self._world.scene)):
            raise TaskRefused(
                f"no tool {number:g}: 0 removes the tool, {known[1]} is the stereo"
                f" head, {known[2]} the surgical guide",
                "Give one of these numbers.",
            )
        for fault in self._board.active(WRONG_TOOL.name):
            number = int(fault.argument)
            self._acted.append(fault)
        self._world.mount_tool(int(number))

    def _move(self, request: dict[str, Any]) -> dict[str, Any]:
        if set(self._devices) < set(devices_of(self._world.scene)):  # a simulator alone
            raise TaskRefused("there is no arm on a cart here", "Give the control port of a theatre.")
        x, y, z = (_require_number(value) for value in request["by_mm"])
        number, turn_deg = _require_number(request["cart"]), _require_number(request["turn_deg"])
        move = CartDisplacement(int(number) if number.is_integer() else 0, (x, y, z), turn_deg)
        move.check(self._world.scene)
        if (inserted := self._world.inserted()) is not None and request.get("anyway") is not True:
            raise INSTRUMENT_IN_GUIDE(
                f"cart {move.number} is not moved: an instrument is in the guide at {inserted}",
                expected="no instrument in the guide",
            )
        self._add_to_script(begin_now(move.line, self._world.clock.now_s()))
        return {TAKES_S: move.duration_s}

    def _stand(self, request: dict[str, Any]) -> None:
        self._world.put_on_stand(OnStand(str(request["holds"])))

    def _fault(self, request: dict[str, Any]) -> dict[str, Any]:
        loaded = None if self._loaded is None else self._loaded()
        line = name_tool(str(request["line"]), self._world.scene, loaded)
        fault = parse_request(line)
        check_faults([fault], self._world.scene, self._devices, loaded)
        line = begin_now(line, self._world.clock.now_s())
        self._add_to_script(line)
        return {"effect": parse_faults(line)[0].effect}

    def _clear_faults(self, request: dict[str, Any]) -> None:
        line = request.get("line")
        if line is not None:
            _, text = self._world.fault_script()
            loaded = None if self._loaded is None else self._loaded()
            ended = name_tool(str(line), self._world.scene, loaded)
            self._world.set_fault_script(without_fault(text, ended))
            return
        # Carts that were moved stay there, beyond a step to which the move was bound.
        begun = [one for one in self._board.acting_since() if one[0].kind is MOVE]
        kept = [f"{format_beginning(onset_s)}: {move.phrase}" for move, onset_s in begun]
        self._world.set_fault_script("\n".join(kept))

    def _add_to_script(self, line: str) -> None:
        _, text = self._world.fault_script()
        self._world.set_fault_script(f"{text}\n{line}" if text else line)

    def _list_missed_faults(self, _request: dict[str, Any]) -> dict[str, Any]:
        missed = []
        for fault in parse_faults(self._world.fault_script()[1]):
            why, step = MISSED_TASK.get(fault.kind.name), self._step_of_onset(fault)
            if why is not None and step is not None and not any(map(fault.same_as, self._acted)):
                ends = fault.at_s is None or math.isfinite(fault.duration_s)
                when = "while it lasted" if ends else "after that"
                missed.append(f"{printable(fault.phrase)} had no effect: it began {step}, and {why} {when}")
        return {"missed": missed[:MOST_MISSED]}

    def _read_wristband(self, _request: dict[str, Any]) -> dict[str, Any]:
        scene = self._world.scene
        return {"wristband": format_patient_id(scene.name, scene.seed)}

    def _tell_truth(self, _request: dict[str, Any]) -> dict[str, Any]:
        if self._truth is None:
            raise TaskRefused(
                "this theatre does not tell the truth", "Start one with --tell-truth, apart from any case."
            )
        return self._truth()

    def _step_of_onset(self, fault: Fault) -> str | None:
        """Describe the step in which a fault began, or return None if it did not begin in this theatre."""
        if fault.at_s is None:
            return next((f"in {name}" for _, name in self._steps if fault.begins_in(name)), None)
        if fault.at_s > self._world.clock.now_s() or 0.0 < fault.at_s <= self._opened_s:
            return None
        begun = [name for begun_s, name in self._steps if begun_s <= fault.at_s]
        return f"in {begun[-1]}" if begun else "before the first step"


def _refusal(reason: object, advice: str) -> dict[str, Any]:
    return {"ok": False, "reason": str(reason)[:LONGEST_REASON], "advice": advice}


def _require_number(value: object) -> float:
    """Return a JSON number; raises TypeError for anything else, including booleans."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"expected a number, got {value!r}")
    return float(value)
