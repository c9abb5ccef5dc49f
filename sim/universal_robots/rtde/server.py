"""RTDE server: all its clients, who owns which input, and the packages of each cycle."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from random import Random
from typing import Any

from ronna_hw.wire.universal_robots import CLIENT_REGISTERS, RTDE_PORT
from sim.universal_robots.connections import ClientConnection, Handler, HangUp, Poll, ServiceListener
from sim.universal_robots.controller import POSES
from sim.universal_robots.loads import FORCE, TORQUES
from sim.universal_robots.model import Model
from sim.universal_robots.robot import Robot
from sim.universal_robots.rtde.recipes import InputRecipe
from sim.universal_robots.rtde.session import BadPackage, Session
from sim.universal_robots.variables import DIGITAL_OUTPUTS, PLACES

STANDARD_ANALOG = ("standard_analog_output_0", "standard_analog_output_1")
GARBAGE = b"\0\7?no RTDE"
OUTPUT_GROUPS = (("standard", 0), ("configurable", 8), ("tool", 16))  # first bit of each group of outputs


class LinkFaults:
    """Faults of the packages, as the script has them."""

    def __init__(self, seed: int) -> None:
        self._random = Random(seed)
        self.skip_percent = self.lose_percent = 0.0
        self.delay_cycles = 0
        self.garbage = False  # ahead of the next packages
        self.idle = True

    def update(self, skip_percent: float, lose_percent: float, delay_cycles: int) -> None:
        """Set the lasting faults."""
        self.skip_percent, self.lose_percent, self.delay_cycles = skip_percent, lose_percent, delay_cycles
        self.idle = not (skip_percent or lose_percent or delay_cycles)

    def skips(self) -> bool:
        """Whether the next package is not sent."""
        return self._random.uniform(0.0, 100.0) < self.skip_percent

    def loses(self) -> bool:
        """Whether a client's package has no effect."""
        return self._random.uniform(0.0, 100.0) < self.lose_percent


class RtdeServer:
    """Serves any number of clients with the variables of one robot."""

    def __init__(self, robot: Robot, address: str, poll: Poll, seed: int) -> None:
        self.parameters = robot.parameters
        self.model: Model = robot.model
        self._robot = robot
        self._values = robot.values
        self._owners: dict[str, Session] = {}
        self.reserved: frozenset[str] = frozenset()  # fault: another client owns these
        self.faults = LinkFaults(seed)
        self._late: deque[tuple[int, InputRecipe, bytes]] = deque()
        self.watched = -1  # place of the input that a watchdog looks at
        self.watched_writes = 0
        self._cycle = 0
        self.wants_poses = self.wants_forces = self.wants_torques = False
        self._clients: list[tuple[ClientConnection, Session]] = []
        self.listener = ServiceListener(
            address, RTDE_PORT, poll, self._connect, send_buffer_bytes=self.parameters.send_buffer_bytes
        )

    def _connect(self, connection: ClientConnection) -> ClientHandler | None:
        most = self.parameters.most_rtde_clients
        if most and len(self._clients) >= most:
            return None
        session = Session(self)
        self._clients.append((connection, session))
        return ClientHandler(self, connection, session)

    def forget(self, session: Session) -> None:
        """Free all that a client owned."""
        self._clients = [client for client in self._clients if client[1] is not session]
        self._owners = {name: owner for name, owner in self._owners.items() if owner is not session}
        self.note_recipes()

    # -- who may write what

    def exists(self, name: str) -> bool:
        """Whether this controller has the field."""
        if self.parameters.upper_registers or "_register_" not in name or "bit" in name:
            return True
        return int(name.rpartition("_")[2]) not in CLIENT_REGISTERS

    def is_taken(self, name: str, session: Session) -> bool:
        """Whether another client or a fieldbus owns an input."""
        owner = self._owners.get(name)
        if (owner is not None and owner is not session) or name in self.reserved:
            return True
        if self.parameters.fieldbus_owns == "lower" and name.startswith(("input_int", "input_double")):
            return int(name.rpartition("_")[2]) not in CLIENT_REGISTERS
        return False

    def take(self, names: Iterable[str], session: Session) -> None:
        """Make a client the owner of inputs."""
        self._owners.update(dict.fromkeys(names, session))

    def owner(self, name: str) -> Session | None:
        """Return the client that owns an input."""
        return self._owners.get(name)

    # -- packages

    def store(self, recipe: InputRecipe, payload: bytes) -> None:
        """Take a package of inputs, unless a fault delays or loses it."""
        faults = self.faults
        if faults.idle:
            self._store(recipe, payload)
        elif not faults.loses():
            self._late.append((self._cycle + faults.delay_cycles, recipe, payload))

    def store_late(self) -> None:
        """Take the delayed packages that are due."""
        while self._late and self._late[0][0] <= self._cycle:
            _, recipe, payload = self._late.popleft()
            self._store(recipe, payload)

    def _store(self, recipe: InputRecipe, payload: bytes) -> None:
        recipe.store(payload, self._values)
        if self.watched >= 0 and recipe.writes(self.watched):
            self.watched_writes += 1
        if recipe.acts:
            self._act(recipe.acting(payload))

    def _act(self, fields: dict[str, Any]) -> None:
        values = self._values
        if fields.get("speed_slider_mask"):
            self._robot.set_speed_fraction(fields.get("speed_slider_fraction", 1.0))
        bits = values[DIGITAL_OUTPUTS]
        for group, first in OUTPUT_GROUPS:
            mask = fields.get(f"{group}_digital_output_mask", 0) << first
            bits = bits & ~mask | fields.get(f"{group}_digital_output", 0) << first & mask
        values[DIGITAL_OUTPUTS] = bits
        mask = fields.get("standard_analog_output_mask", 0)
        for number, name in enumerate(STANDARD_ANALOG):
            if mask & 1 << number:
                values[PLACES[f"standard_analog_output{number}"].start] = fields.get(name, 0.0)

    def note_recipes(self) -> None:
        """Look again whether any client reads poses, velocities or forces of the tool, or torques."""
        recipes = [session.output for _, session in self._clients]
        self.wants_poses = any(recipe and not POSES.isdisjoint(recipe.names) for recipe in recipes)
        self.wants_forces = any(recipe and FORCE in recipe.names for recipe in recipes)
        self.wants_torques = any(recipe and not TORQUES.isdisjoint(recipe.names) for recipe in recipes)

    def send_outputs(self) -> None:
        """Send this cycle's package to each client that is due."""
        self._cycle += 1
        cycle, values = self._cycle, self._values
        faults = self.faults
        plain = faults.idle and not faults.garbage
        for connection, session in self._clients:
            recipe = session.output
            if session.started and recipe is not None and cycle % recipe.divider == 0:
                if plain:
                    session.sent_cycle = cycle
                    connection.send(recipe.pack(values))
                elif not faults.skips():
                    session.sent_cycle = cycle
                    connection.send((GARBAGE if faults.garbage else b"") + recipe.pack(values))
        faults.garbage = False

    def awaits(self, session: Session) -> bool:
        """Whether a client got a package in this cycle."""
        return session.sent_cycle == self._cycle


class ClientHandler(Handler):
    """Connects a session with its socket."""

    def __init__(self, server: RtdeServer, connection: ClientConnection, session: Session) -> None:
        self._server, self._connection, self._session = server, connection, session

    def receive(self, data: bytes) -> bytes:
        """Hand bytes to the session and return its answers."""
        session = self._session
        try:
            session.receive(data)
        except BadPackage:
            raise HangUp from None
        if session.answers:
            answer, session.answers = b"".join(session.answers), []
            return answer
        return b""

    def closed(self) -> None:
        """Free what the client owned."""
        self._server.forget(self._session)
