"""Controller cycle loop, in real time or lock-step, serving the EKI channels between cycles.

A single thread does everything: no locks, and no other thread competes for the interpreter. It waits in one
`select` over the RSI socket, or its alarm while it rests, and the channels.

Real time: telegram k is sent at t0 + k cycles. Lock-step (a theatre at full speed): the next telegram is sent
once the reply has arrived. While the correction is unchanged, the controller rests until someone waits for
theatre time, so that what a client finds hardly depends on how long its host computed meanwhile. A resting
controller still runs a cycle now and then, for clients that only watch.
"""

from __future__ import annotations

import os
import select
import socket
import time
from collections.abc import Sequence

from ronna_hw.clock import FOR_READER, FOR_TURN
from ronna_hw.logs import logger
from ronna_hw.wire.kuka_eki import RsiState
from sim.kuka.autostart import Autostart
from sim.kuka.controller import Controller
from sim.kuka.eki.project_channel import ProjectChannel
from sim.kuka.eki.sdk_channel import SdkChannel
from sim.kuka.eki.server import EkiServer
from sim.kuka.faults import ControllerFaults
from sim.kuka.motor_currents import MotorCurrents
from sim.kuka.pendant import PendantDisplay
from sim.kuka.rsi.link import LinkFaults, RsiSocket
from sim.kuka.rsi.program_run import RsiRun
from sim.kuka.rsi.telegrams import NO_CURRENTS, NO_FORCES, Reply
from sim.world.faults import FaultBoard
from sim.world.faults.log import FaultLog
from sim.world.force_sensor import sensor_of
from sim.world.world import World

IDLE_WAIT_S = 0.02  # wait between checks for a program to run, a reader, a turn and the end of the process
REPLY_WAIT_S = 2.0  # host time that lock-step waits for a reply
READER_WAIT_S = 1.0  # host time it waits for a client reading frame by frame; below that client's limit
REST_CYCLE_S = 0.1  # host time of a cycle at rest, and between checks of the fault script and for the end of
# the process; below the limits of clients for a silent controller
SERVE_S = 0.005  # host time between checks of the EKI channels while lock-step runs at full speed
UNCHANGED_CYCLES = 10  # without a new correction, after which lock-step rests
STALE_LIMIT = 256  # datagrams read per cycle; a flood must not stop the clock


class CycleLoop:
    """Runs a controller cycle by cycle until `end` is called."""

    def __init__(
        self,
        controller: Controller,
        world: World,
        client: tuple[str, int],
        project_server: EkiServer,
        sdk_server: EkiServer,
        autostart: Autostart,
    ) -> None:
        self._controller = controller
        self._clock = world.clock
        self._alarm = self._clock.open_alarm()
        self._client = client
        self._servers = (project_server, sdk_server)
        log = FaultLog(self._fault_time)
        self._takes_second = controller.parameters.second_reply == "taken"
        self._currents = MotorCurrents(world, controller.arm.drives, controller.parameters)
        self._force_sensor = sensor_of(world, world.role)
        self._link = LinkFaults(world.scene.seed, log.hit, takes_second=self._takes_second)
        board = FaultBoard(world, "robot", self._cycle_number)
        self._faults = ControllerFaults(board, controller, self._servers, self._link, log)
        self._log = logger(device="kuka")
        self._display = PendantDisplay(world.clock.now_s)
        self._project = ProjectChannel(project_server, controller, autostart)
        self._sdk = SdkChannel(sdk_server, controller, autostart)
        self._autostart = autostart
        self._ending = False
        self._run: RsiRun | None = None
        self._rsi: RsiSocket | None = None
        self._foreign: RsiSocket | None = None
        self._datagram: bytes | None = None
        self._deadline_s = 0.0
        self._tick_s = self._served_s = 0.0
        self._reported: tuple[RsiState, bool] | None = None
        self._silent = False
        self._shared_processor = len(os.sched_getaffinity(0)) == 1  # busy waiting would starve the client
        self._unchanged = 0
        self._last_command: list[float] = []
        self.cycles = 0

    def end(self) -> None:
        """Make `run` return soon; safe to call from a signal handler or another thread."""
        self._ending = True

    def run(self) -> None:
        """Serve until `end` is called."""
        self._autostart.begin()
        try:
            while not self._ending:
                self._faults.poll()
                self._update_display()
                if self._controller.run is not None:
                    self._run_cycle(self._controller.run)
                elif self._rsi is not None or self._controller.moving:
                    self._settle()
                else:
                    self._autostart.tick(time.monotonic())
                    if self._controller.run is None:
                        self._wait_until(None, time.monotonic() + IDLE_WAIT_S)
        finally:
            self._clock.end_stream()
            self._close_rsi()
            self._alarm.close()
            for server in self._servers:
                server.close()

    # -- one cycle

    def _run_cycle(self, run: RsiRun) -> None:
        if run is not self._run:
            self._enter_run(run)
        assert self._rsi is not None
        controller = self._controller
        cycle_s = run.settings.cycle_ms / 1000.0
        began_s = time.monotonic()
        currents = self._currents.at(self.cycles) if run.states_currents else NO_CURRENTS
        forces: Sequence[float] = NO_FORCES
        if self._force_sensor is not None and run.states_forces:
            forces = self._force_sensor.read(self.cycles, is_dead=controller.is_sensor_dead)
        telegram = run.telegram(controller.arm.reported_frame, controller.arm.reported_deg, currents, forces)
        answerable = True
        self._link.cycle = self.cycles + 1
        if not run.streams:
            answerable = False
        elif self._link.idle:
            self._rsi.send(telegram)
        else:
            answerable = self._send_with_faults(run, telegram)
        lock_step = not self._clock.paced and not run.settings.context.ethernet.only_send
        if not lock_step:
            # An absolute schedule; after a stall of the host it restarts instead of catching up.
            self._deadline_s += cycle_s
            if self._deadline_s < began_s:
                self._deadline_s = began_s + cycle_s
            late_s = (1.0 - controller.parameters.reply_window) * cycle_s
            reply = self._await_reply(run, self._deadline_s - late_s)
            self._wait_until(run, self._deadline_s)
        elif answerable:
            limit_s = cycle_s if self._silent else REPLY_WAIT_S
            reply = self._await_reply_in_lock_step(run, began_s + limit_s)
            self._silent = reply is None
        else:
            reply = self._datagram = None
        self._faults.poll()  # a fault may have become due while the client worked
        if not self._link.idle:
            reply = self._link.incoming(self._datagram, run.read)
        if controller.run is not run:
            return  # ended by a request during the wait
        self.cycles += 1
        controller.finish_cycle(reply)
        if run.held and not controller.moving:
            self._autostart.tick(time.monotonic())
        self._report_change()
        self._count_unchanged(run)
        at_rest = reply is not None and self._link.idle
        if not self._clock.paced:
            stands = lock_step and at_rest and self._unchanged >= UNCHANGED_CYCLES and not controller.moving
            self._advance(run.settings.cycle_ms * 1_000_000, stands=stands)
        if lock_step:
            # A silent client, or a fault of the link, runs its course in real time.
            self._pace(run, began_s + (REST_CYCLE_S if at_rest else cycle_s))

    def _count_unchanged(self, run: RsiRun) -> None:
        self._unchanged = self._unchanged + 1 if run.command_deg is self._last_command else 0
        self._last_command = run.command_deg

    def _pace(self, run: RsiRun, next_s: float) -> None:
        """Rest until `next_s` (host time) if nothing changes and nobody waits for theatre time."""
        if self._unchanged >= UNCHANGED_CYCLES:
            with self._clock.rest(self._alarm):
                while self._may_rest(run) and (remaining_s := next_s - time.monotonic()) > 0.0:
                    if self._wait_once(remaining_s, self._alarm):
                        self._clock.silence(self._alarm)
                    self._faults.poll()
        self._serve_timers(time.monotonic())

    def _may_rest(self, run: RsiRun) -> bool:
        controller = self._controller
        return not (self._ending or controller.run is not run or controller.moving or self._clock.may_pass())

    def _send_with_faults(self, run: RsiRun, telegram: bytes) -> bool:
        """Send a telegram subject to link faults and return whether the client can answer it."""
        assert self._rsi is not None
        link = self._link
        if link.is_active("foreign_sender"):
            self._foreign = self._foreign or RsiSocket(self._client)
            self._foreign.send(run.with_other_stamp(telegram))
        if link.is_active("short_first") and not run.sent_once:
            telegram = run.short_telegram()
        leaving, answerable = link.outgoing(telegram)
        if leaving is not None:
            self._rsi.send(leaving)
        return answerable

    def _cycle_number(self) -> int:
        """Return the number of the next telegram, or of the last one between runs, across all runs."""
        return self.cycles + (self._controller.run is not None)

    def _fault_time(self) -> tuple[float, str]:
        """Return the theatre time and the next telegram's IPOC."""
        run = self._controller.run
        return self._clock.now_s(), f"IPOC {run.ipoc}" if run is not None else "no RSI"

    def _close_rsi(self) -> None:
        for link in (self._rsi, self._foreign):
            if link is not None:
                link.close()
        self._rsi = self._foreign = self._run = None

    def _enter_run(self, run: RsiRun) -> None:
        self._close_rsi()
        self._link.begin_run()
        self._run = run
        self._rsi = RsiSocket(self._client)
        self._deadline_s = time.monotonic()
        self._silent = False
        self._unchanged = 0
        self._last_command = run.command_deg

    def _settle(self) -> None:
        """Run one cycle of a motion or of braking to rest, then release control of theatre time."""
        if self._rsi is not None:
            self._close_rsi()
            self._deadline_s = time.monotonic()
        cycle_s = self._controller.cycle_ms / 1000.0
        if self._controller.moving:
            self._controller.settle()
            if self._clock.paced:
                self._deadline_s = max(self._deadline_s + cycle_s, time.monotonic())
                self._wait_until(self._controller.run, self._deadline_s)
            else:
                self._advance(round(cycle_s * 1e9))
                self._end_stream_at_rest()  # before the motion is reported as done
                self._wait_once(0.0, None)  # a motion may be stopped on its way
        self._end_stream_at_rest()
        self._report_change()

    def _end_stream_at_rest(self) -> None:
        if not self._controller.moving:
            self._clock.end_stream()

    def _advance(self, cycle_ns: int, *, stands: bool = False) -> None:
        """Advance theatre time by a cycle once a frame-by-frame client has requested the next frame.

        Then the other arm has its turn, if it streams and is too far behind.
        """
        limit_s = time.monotonic() + READER_WAIT_S
        while self._clock.must_wait_for_reader(cycle_ns) and not self._ending:
            if time.monotonic() > limit_s:
                self._clock.expect_reader(0)  # it has stopped reading
                break
            with self._clock.rest(self._alarm, FOR_READER):
                if self._clock.must_wait_for_reader(cycle_ns):
                    select.select([self._alarm], (), (), IDLE_WAIT_S)
                    self._clock.silence(self._alarm)
        self._clock.advance_cycle(cycle_ns, stands=stands)
        while self._clock.must_wait_for_turn() and not self._ending:
            with self._clock.rest(self._alarm, FOR_TURN):
                if self._clock.must_wait_for_turn() and self._wait_once(IDLE_WAIT_S, self._alarm):
                    self._clock.silence(self._alarm)

    def _update_display(self) -> None:
        run = self._controller.run
        self._display.update(self._controller.message, run.notice if run is not None else "")
        if run is not None:
            run.rejected.report(time.monotonic(), lambda reason, count: self._log.info(reason, so_far=count))

    def _report_change(self) -> None:
        """Make the channels report a state change at once rather than at the end of their period."""
        state = (self._controller.rsi_state, self._controller.moving)
        if state != self._reported:
            self._reported = state
            self._tick_s = 0.0

    # -- waiting

    def _await_reply(self, run: RsiRun, limit_s: float) -> Reply | None:
        """Wait for this cycle's reply, or return None if it has not arrived by `limit_s` (host time)."""
        assert self._rsi is not None
        budget = STALE_LIMIT
        self._datagram = found = None
        while True:
            # The time is taken first: a reply in the socket at the limit has arrived in time.
            now_s = time.monotonic()
            if self._wait_once(max(0.0, limit_s - now_s), self._rsi.socket):
                while budget:
                    budget -= 1
                    data = self._rsi.receive()
                    if data is None:
                        break
                    reply = run.read(data)
                    if reply is not None:
                        self._datagram, found = data, reply
                        if not self._takes_second:
                            return reply
            if now_s >= limit_s or not budget or self._ending or self._controller.run is not run:
                return found

    def _await_reply_in_lock_step(self, run: RsiRun, limit_s: float) -> Reply | None:
        """Wait for the reply while occasionally serving the channels, or return None after `limit_s`."""
        assert self._rsi is not None
        budget = STALE_LIMIT
        self._datagram = None
        awake = self._unchanged < UNCHANGED_CYCLES and not self._shared_processor
        while True:
            data, awake = self._rsi.wait_for_datagram(awake=awake), False
            now_s = time.monotonic()
            if now_s - self._served_s > SERVE_S:
                self._wait_once(0.0, None)
            if data is not None:
                budget -= 1
                reply = run.read(data)
                if reply is not None:
                    self._datagram = data
                    return reply
            if now_s >= limit_s or not budget or self._ending or self._controller.run is not run:
                return None

    def _wait_until(self, run: RsiRun | None, moment_s: float) -> None:
        """Wait while serving the channels, but return early if the run ends or another begins."""
        while not self._ending and self._controller.run is run:
            remaining_s = moment_s - time.monotonic()
            if remaining_s <= 0.0:
                return
            self._wait_once(remaining_s, None)

    def _wait_once(self, timeout_s: float, wanted: socket.socket | None) -> bool:
        """Wait once while serving channels and timers, and return whether `wanted` is readable."""
        waiting: list[socket.socket] = [wanted] if wanted is not None else []
        for server in self._servers:
            waiting += server.sockets
        now_s = time.monotonic()
        timeout_s = min(timeout_s, max(0.0, self._tick_s - now_s))
        ready, _, _ = select.select(waiting, (), (), timeout_s)
        if ready and self._controller.run is None:
            self._faults.poll()  # a fault that was given before a client connected acts on it
        is_readable = False
        for one in ready:
            if one is wanted:
                is_readable = True
                continue
            for server in self._servers:
                server.serve(one)
            self._tick_s = 0.0
        self._served_s = time.monotonic()
        self._serve_timers(self._served_s)
        return is_readable

    def _serve_timers(self, now_s: float) -> None:
        if now_s < self._tick_s:
            return
        for server in self._servers:
            server.flush()
        again_s = min(self._project.tick(now_s), self._sdk.tick(now_s))
        due = [server.due_s for server in self._servers if server.due_s is not None]
        self._tick_s = min([again_s, *due])
