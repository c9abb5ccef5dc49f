"""Control cycle, in real time or lock-step, serving all clients between cycles.

A single thread does everything: no locks, and no other thread competes for the interpreter. It waits in one
`select` over all sockets.

Real time: cycle k begins at t0 + k cycles. Lock-step: while our script streams, the next cycle begins once
the client that owns its registers has answered the package of the last one. While its set-point is unchanged,
the controller of a theatre rests until someone waits for theatre time; one that stands alone, with a clock
that nobody else has, goes on in real time. Without such a program cycles run in real time: clients that only
watch could not follow faster ones.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from ronna_hw.clock import FOR_READER, FOR_TURN
from ronna_hw.wire.universal_robots import SEQUENCE_INPUT
from sim.universal_robots.arm_in_world import ArmInWorld
from sim.universal_robots.connections import Poll
from sim.universal_robots.controller import Controller
from sim.universal_robots.faults import ControllerFaults
from sim.universal_robots.interfaces.clients import ClientInterfaces
from sim.universal_robots.interfaces.dashboard import Dashboard
from sim.universal_robots.rtde.server import RtdeServer
from sim.universal_robots.rtde.session import Session
from sim.world.faults import FaultBoard
from sim.world.faults.log import FaultLog
from sim.world.world import World

REPLY_WAIT_S = 2.0  # host time that lock-step waits for a set-point
REST_CYCLE_S = 0.1  # host time of a cycle at rest; below the limits of clients for a silent controller
READER_WAIT_S = 1.0  # host time it waits for a client reading frame by frame; below that client's limit
UNCHANGED_CYCLES = 10  # without a new set-point, after which lock-step rests
LATE_CYCLES = 5  # after which the schedule begins anew instead of catching up
IDLE_WAIT_S = 0.02
AWAKE_S = 60e-6  # busy-wait for a set-point: longer than a client needs that has its reply prepared


class CycleLoop:
    """Runs a controller cycle by cycle until `end` is called."""

    def __init__(
        self,
        controller: Controller,
        arm: ArmInWorld,
        mounted_tool: Callable[[], int],
        world: World,
        address: str,
        *,
        alone: bool = False,
    ) -> None:
        """Serve at an address; `alone`: the world is not that of a theatre."""
        self._controller = controller
        self._arm = arm
        self._mounted_tool = mounted_tool
        self._clock = world.clock
        self._poll = Poll()
        self.rtde = RtdeServer(controller.robot, address, self._poll, world.scene.seed)
        controller.watched = lambda: self.rtde.watched_writes
        self.clients = ClientInterfaces(controller, address, self._poll)
        self.dashboard = Dashboard(controller, address, self._poll)
        log = FaultLog(lambda: (self._clock.now_s(), f"cycle {self._cycle_number()}"))
        board = FaultBoard(world, "ur", self._cycle_number)
        self._faults = ControllerFaults(board, controller, self.rtde, self.clients, self.dashboard, log)
        self._alarm = self._clock.open_alarm()
        self._poll.register(self._alarm, lambda: self._clock.silence(self._alarm))
        self._cycle_s = controller.model.cycle_s
        self._cycle_ns = round(self._cycle_s * 1e9)
        self._lock_step = not self._clock.paced
        self._rest_cycle_s = self._cycle_s if alone else REST_CYCLE_S
        self._deadline_s = 0.0
        self._ending = False
        self._silent = False  # the client that sends set-points did not answer in time
        self._streams = False  # the cycles advance theatre time
        self._unchanged = 0
        # On a single processor the client works only while this one sleeps.
        self._has_own_processor = len(os.sched_getaffinity(0)) > 1
        self._last_target: object = None

    @property
    def endpoints(self) -> dict[str, str]:
        """Endpoints of the clients."""
        return {
            "rtde": self.rtde.listener.endpoint,
            "dashboard": self.dashboard.listener.endpoint,
            "primary": self.clients.primary.endpoint,
            "secondary": self.clients.secondary.endpoint,
            "realtime": self.clients.realtime.endpoint,
        }

    def end(self) -> None:
        """Make `run` return soon; safe to call from a signal handler or another thread."""
        self._ending = True

    def run(self) -> None:
        """Serve until `end` is called."""
        self._deadline_s = time.monotonic()
        try:
            while not self._ending:
                self._run_cycle()
        finally:
            self._clock.end_stream()
            for listener in (self.rtde.listener, self.dashboard.listener, *self.clients.listeners):
                listener.close()
            self._alarm.close()
            self._poll.close()

    def _cycle_number(self) -> int:
        return self._controller.cycles + 1

    def _run_cycle(self) -> None:
        self._faults.poll()
        if self._faults.frozen:
            self._pace()
            if self._streams:
                self._advance(streams=True)
            return
        controller, program = self._controller, self._controller.program
        watchdog = None if program is None else program.watchdog
        self.rtde.watched = -1 if watchdog is None else watchdog.place
        shows_all = bool(self.clients.realtime.connections)
        controller.shows_poses = shows_all or self.rtde.wants_poses
        controller.loads.shows_forces = shows_all or self.rtde.wants_forces
        controller.loads.shows_torques = shows_all or self.rtde.wants_torques
        self.rtde.store_late()
        controller.robot.set_mounted_tool(self._mounted_tool())
        controller.step()
        self.rtde.send_outputs()
        self._arm.follow()  # once the package is out: its client computes at the same time
        self.clients.send_state()
        streamer = self._streamer()
        if streamer is None or self._faults.is_cut:
            self._pace()
        elif self.rtde.awaits(streamer):
            self._await_set_point(streamer)
        else:
            self._poll.serve(0.0)
        if self._lock_step:
            self._advance(streams=streamer is not None)

    def _streamer(self) -> Session | None:
        """Return the client whose set-point lock-step waits for."""
        program = self._controller.program
        if not self._lock_step or program is None or not program.awaits_client:
            return None
        owner = self.rtde.owner(SEQUENCE_INPUT)
        return owner if owner is not None and owner.started else None

    # -- waiting

    def _pace(self) -> None:
        """Wait for the next cycle of an absolute schedule; after a stall of the host it begins anew."""
        self._deadline_s += self._cycle_s
        now_s = time.monotonic()
        if now_s - self._deadline_s > LATE_CYCLES * self._cycle_s:
            self._deadline_s = now_s
        while not self._ending:
            self._poll.serve(max(0.0, self._deadline_s - now_s))
            now_s = time.monotonic()
            if now_s >= self._deadline_s:
                return

    def _await_set_point(self, streamer: Session) -> None:
        """Wait for the answer to this cycle's package; a silent client's cycles run in real time."""
        began_s = time.monotonic()
        limit_s = began_s + (self._cycle_s if self._silent else REPLY_WAIT_S)
        packages = streamer.packages
        is_awake = self._has_own_processor and self._unchanged < UNCHANGED_CYCLES and not self._silent
        # Awake at first: two processes that alternate this fast spend most of their time waking each other.
        awake_s = began_s + AWAKE_S if is_awake else 0.0
        wait_s = 0.0 if is_awake else limit_s - began_s
        while True:
            self._poll.serve(wait_s)
            if streamer.packages != packages:
                self._silent = False
                break
            now_s = time.monotonic()
            if now_s < awake_s:
                continue
            if self._ending or self._streamer() is not streamer:
                break
            wait_s = limit_s - now_s
            if wait_s <= 0.0:
                self._silent = True
                break
        self._rest(streamer, began_s + self._rest_cycle_s)
        self._deadline_s = time.monotonic()

    def _rest(self, streamer: Session, next_s: float) -> None:
        """Rest until `next_s` (host time) if nothing changes and nobody waits for theatre time."""
        drives = self._controller.robot.drives
        if drives.target is not self._last_target or drives.moving:
            self._last_target, self._unchanged = drives.target, 0
            return
        self._unchanged += 1
        if self._unchanged < UNCHANGED_CYCLES:
            return
        with self._clock.rest(self._alarm):
            while (
                not self._ending
                and self._streamer() is streamer
                and not self._clock.may_pass()
                and (remaining_s := next_s - time.monotonic()) > 0.0
            ):
                self._poll.serve(remaining_s)

    @property
    def _stands(self) -> bool:
        """Whether the arm's cycles show nothing new, and nothing counts them."""
        awaits_nothing = not (self._silent or self._faults.frozen or self._controller.modes.is_in_transition)
        return awaits_nothing and self._unchanged >= UNCHANGED_CYCLES

    def _advance(self, *, streams: bool) -> None:
        """Advance theatre time by a cycle while the arm moves or streams; otherwise others may."""
        if not streams and not self._controller.robot.drives.moving:
            if self._streams:
                self._streams = False
                self._clock.end_stream()
            return
        self._streams = True
        limit_s = time.monotonic() + READER_WAIT_S
        while self._clock.must_wait_for_reader(self._cycle_ns) and not self._ending:
            if time.monotonic() > limit_s:
                self._clock.expect_reader(0)  # it has stopped reading
                break
            with self._clock.rest(self._alarm, FOR_READER):
                if self._clock.must_wait_for_reader(self._cycle_ns):
                    self._poll.serve(IDLE_WAIT_S)
        self._clock.advance_cycle(self._cycle_ns, stands=self._stands)
        while self._clock.must_wait_for_turn() and not self._ending:
            with self._clock.rest(self._alarm, FOR_TURN):
                if self._clock.must_wait_for_turn():
                    self._poll.serve(IDLE_WAIT_S)
