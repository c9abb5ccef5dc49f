"""Requests accepted at the control port, the scripted operator's only access to the simulated room.

`{"do": "step", "name": "..."}`, `{"do": "mount", "number": 2}`, `{"do": "stand", "holds": "divot"}`, `{"do":
"fault", "line": "now: ..."}`, `{"do": "clear_faults"}`, with a `line` only that fault, and `{"do": "work",
"task": "insert", "trajectory": "T1", "numbers": []}`, whose answer has `readings`. Inserting an instrument
samples the truth at that target.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ronna_hw.errors import RonnaError
from sim.world.faults import (
    DEVICES,
    FaultBoard,
    begin_now,
    begin_with_step,
    check_faults,
    parse_faults,
    parse_request,
    without_fault,
)
from sim.world.faults.room import DEVICE, WRONG_TOOL, tool_numbers
from sim.world.hands import Hands, NoSuchTask, NoTrajectory, WrongNumbers
from sim.world.left_world import write_left_world
from sim.world.on_stand import OnStand
from sim.world.world import World

LONGEST_REASON = 500  # characters: it may quote the request


class NoSuchTool(Exception):
    """No tool in this room has this number."""


class Room:
    """What the operator can do in the room. Truth at a target is stored in `folder`, if there is one.

    `devices` are those simulated here: faults of others are refused. `loaded` returns the tools that a client
    has loaded into the tracker, if it is in this process.
    """

    def __init__(
        self,
        world: World,
        folder: Path | None,
        devices: Sequence[str] = DEVICES,
        loaded: Callable[[], Sequence[str]] | None = None,
    ) -> None:
        self._world = world
        self._folder = folder
        self._devices = devices
        self._loaded = loaded
        self._hands = Hands(world, folder)
        self._board = FaultBoard(world, DEVICE)
        self._one_at_a_time = threading.Lock()  # several connections may ask

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out one request; an unknown or invalid one is answered with the reason."""
        actions: dict[str, Callable[[dict[str, Any]], dict[str, Any] | None]] = {
            "step": self._step,
            "work": self._work,
            "mount": self._mount,
            "stand": self._stand,
            "fault": self._fault,
            "clear_faults": self._clear_faults,
        }
        action = actions.get(str(request.get("do")))
        if action is None:
            return {"ok": False, "reason": f"unknown request; known: {', '.join(actions)}"}
        try:
            with self._one_at_a_time:
                more = action(request) or {}
        except NoSuchTool as error:
            return _refused(error, "Give one of these numbers.")
        except (NoSuchTask, NoTrajectory) as error:
            return _refused(error, error.advice)
        except WrongNumbers as error:
            return _refused(error, "Give the numbers as in the question.")
        except RonnaError as error:
            return {
                "ok": False,
                "reason": f"{error.code}: {error.summary}"[:LONGEST_REASON],
                "advice": error.advice[:LONGEST_REASON],
            }
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            return {"ok": False, "reason": f"bad request: {error!r}"[:LONGEST_REASON]}
        except Exception as error:  # a mistake of ours: an answer says more than a closed connection
            traceback.print_exc()
            return _refused(f"the simulator failed: {error!r}", "Report this with the output of the theatre.")
        return {"ok": True, "theatre_time_s": self._world.clock.now_s(), **more}

    def _step(self, request: dict[str, Any]) -> None:
        name = str(request["name"])
        _, text = self._world.fault_script()
        begun = begin_with_step(text, name, self._world.clock.now_s())
        if begun != text:
            self._world.set_fault_script(begun)
        self._world.enter_step(name)

    def _work(self, request: dict[str, Any]) -> dict[str, Any]:
        numbers = [_number(value) for value in request.get("numbers", ())]
        readings = self._hands.work(str(request["task"]), str(request.get("trajectory", "")), numbers)
        return {"readings": list(readings)}

    def _mount(self, request: dict[str, Any]) -> None:
        number = _number(request["number"])
        if number not in (known := tool_numbers(self._world.scene)):
            raise NoSuchTool(
                f"no tool {number:g}: 0 removes the tool, {known[1]} is the stereo"
                f" head, {known[2]} the surgical guide"
            )
        for mistaken in self._board.active(WRONG_TOOL.name):
            number = int(mistaken.argument)
        self._world.mount_tool(int(number))
        if self._folder is not None:
            write_left_world(self._world, self._folder)

    def _stand(self, request: dict[str, Any]) -> None:
        self._world.put_on_stand(OnStand(str(request["holds"])))

    def _fault(self, request: dict[str, Any]) -> dict[str, Any]:
        line = str(request["line"])
        asked = parse_request(line)
        loaded = None if self._loaded is None else self._loaded()
        check_faults([asked], self._world.scene, self._devices, loaded)
        _, text = self._world.fault_script()
        line = begin_now(line, self._world.clock.now_s())
        self._world.set_fault_script(f"{text}\n{line}" if text else line)
        return {"effect": parse_faults(line)[0].effect}

    def _clear_faults(self, request: dict[str, Any]) -> None:
        line = request.get("line")
        _, text = self._world.fault_script()
        self._world.set_fault_script("" if line is None else without_fault(text, str(line)))


def _refused(reason: object, advice: str) -> dict[str, Any]:
    return {"ok": False, "reason": str(reason)[:LONGEST_REASON], "advice": advice}


def _number(value: object) -> float:
    """Of JSON, where text and truth values are none; raises TypeError."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"expected a number, got {value!r}")
    return float(value)
