"""OpenIGTLink server of a case: eight clients, one of them stopped, beside a bare asyncio sender.

Ages are from the stamp of a pose to its arrival at the client, through the feed of the case and the server.
"""

from __future__ import annotations

import select
import socket
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from benchmarks.figures import Figure, process_cpu_s
from benchmarks.robot.robot_cell import peer
from procedures.journal.journal import JOURNAL_FILE
from procedures.live.feed_socket import FeedSocket
from procedures.live.records import Began, FramePose
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.request_file import write_request
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.wire.openigtlink import Message, MessageReader

CLIENTS = 8
STOPPED = 1  # of them
RATE_HZ = 60.0
POSES = (
    ("tool", "robot"),
    ("flange", "robot"),
    ("tracker", "robot"),
    ("robot_frame", "tracker"),
    ("guide_frame", "tracker"),
    ("patient_frame", "tracker"),
)
ROUNDS, BLOCK_S = 3, 10.0
SMALLEST_BLOCK_S = 0.5
SETTLED_S = 0.5  # before a block is measured: imports and first messages
DRAIN_S = 0.5  # without arrivals: everything has come
NS_PER_MS = 1e6
MOST_CPU_PERCENT = 10.0  # of a core, more than the bare sender
LARGEST_AGE_MS = 2.0
OURS, BARE = "our server", "bare asyncio sender"
WHAT = "6 poses at 60 Hz to 8 clients, one stopped"


@dataclass(frozen=True)
class Block:
    """CPU of the sender in % of a core, poses that some of its reading clients missed, and ages in ms."""

    cpu_percent: float
    missed: int
    merged: int  # poses that nobody got: a newer one replaced them ahead of the server
    ages_ms: Sequence[float]


def measure(smallest: bool = False) -> list[Figure]:
    duration_s, rounds = (SMALLEST_BLOCK_S, 1) if smallest else (BLOCK_S, ROUNDS)
    ours, bare = zip(*((_run_ours(duration_s), _run_bare(duration_s)) for _ in range(rounds)), strict=True)
    cpu = {name: median(one.cpu_percent for one in blocks) for name, blocks in ((OURS, ours), (BARE, bare))}
    more = median(one.cpu_percent - other.cpu_percent for one, other in zip(ours, bare, strict=True))
    ages_ms = sorted(age for one in ours for age in one.ages_ms)
    worst_ms = ages_ms[int(0.99 * len(ages_ms))]
    missed, merged = sum(one.missed for one in ours), sum(one.merged for one in ours)
    return [
        Figure(f"CPU, {WHAT}", OURS, cpu[OURS], "% of a core"),
        Figure(f"CPU, {WHAT}", BARE, cpu[BARE], "% of a core"),
        Figure(f"CPU more than the bare sender, {WHAT}", OURS, more, "% of a core").at_most(MOST_CPU_PERCENT),
        Figure(f"age of a pose, {WHAT}", OURS, median(ages_ms), "ms", more={"p99": worst_ms}).at_most(
            LARGEST_AGE_MS
        ),
        Figure(
            f"poses missed by a reading client, {WHAT}", OURS, missed, "messages", more={"by all": merged}
        ).at_most(0),
    ]


def _run_ours(duration_s: float) -> Block:
    with ExitStack() as stack:
        run = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write_request(RunRequest(procedure=CaseProcedure()), run)
        (run / JOURNAL_FILE).touch()
        epoch_ns = time.time_ns()
        feed = FeedSocket(run, Began(theatre_time_s=0.0, run=run.name, epoch_ns=epoch_ns))
        stack.callback(feed.close)
        line = command("procedures.cli.link", "openigtlink", str(run), "--port", "0", "--rate", "1000")
        server = stack.enter_context(ChildProcess("ronna-link", line))
        clients = _connect(stack, int(server.ready["openigtlink"].rpartition(":")[2]))
        sent = _Frames(feed, epoch_ns, duration_s)
        time.sleep(SETTLED_S)
        before_s = process_cpu_s(server.process.pid)
        sent.start()
        messages = _receive(clients, duration_s)
        sent.join()
        cpu_s = process_cpu_s(server.process.pid) - before_s
        poses = [(at_ns, one) for at_ns, one in messages if one.kind == "TRANSFORM"]
        ages_ms = [(at_ns - one.stamp_ns) / NS_PER_MS for at_ns, one in poses]
        served = len({(one.name, one.stamp_ns) for _, one in poses})
        missed = served * (CLIENTS - STOPPED) - len(poses)
        return Block(100.0 * cpu_s / duration_s, missed, len(POSES) * sent.count - served, ages_ms)


class _Frames(threading.Thread):
    """Feeds all poses at the rate, as a case does."""

    def __init__(self, feed: FeedSocket, epoch_ns: int, duration_s: float) -> None:
        super().__init__()
        self._feed, self._epoch_ns = feed, epoch_ns
        self.count = round(duration_s * RATE_HZ)

    def run(self) -> None:
        begun_s = time.monotonic()
        for number in range(self.count):
            time.sleep(max(0.0, begun_s + number / RATE_HZ - time.monotonic()))
            now_s = (time.time_ns() - self._epoch_ns) / 1e9
            self._feed.offer(
                FramePose(
                    theatre_time_s=now_s,
                    parent=parent,
                    child=child,
                    rotation=(1.0, 0.0, 0.0, 0.0),
                    translation_mm=(float(number), 0.0, 0.0),
                )
                for child, parent in POSES
            )


def _run_bare(duration_s: float) -> Block:
    with ExitStack() as stack:
        sender = stack.enter_context(peer("bare_igtl_sender", str(len(POSES)), str(RATE_HZ)))
        clients = _connect(stack, int(sender.ready["port"]))
        time.sleep(SETTLED_S)
        before_s = process_cpu_s(sender.process.pid)
        _receive(clients, duration_s, drain=False)
        return Block(100.0 * (process_cpu_s(sender.process.pid) - before_s) / duration_s, 0, 0, ())


def _connect(stack: ExitStack, port: int) -> list[socket.socket]:
    """Connect all clients; nobody reads from the last."""
    return [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(CLIENTS)]


def _receive(
    clients: list[socket.socket], duration_s: float, *, drain: bool = True
) -> list[tuple[int, Message]]:
    """Read all clients but the stopped ones; return messages with their times of arrival."""
    arrived: list[tuple[int, socket.socket, bytes]] = []
    until_s = time.monotonic() + duration_s
    while True:
        left_s = until_s - time.monotonic()
        ready, _, _ = select.select(clients[STOPPED:], [], [], max(left_s, DRAIN_S if drain else 0.0))
        arrived += [(time.time_ns(), one, one.recv(1 << 16)) for one in ready]
        if left_s <= 0.0 and (not drain or not ready or left_s < -DRAIN_S):
            break
    readers = {one: MessageReader() for one in clients}
    return [(at_ns, message) for at_ns, one, data in arrived for message in readers[one].feed(data)]
