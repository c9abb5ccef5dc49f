"""Case shared by all pages: its state, its subscribers, and the channel for orders to its engine."""

from __future__ import annotations

import asyncio
import json
import secrets
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from console.changes import ChangeNotifier
from console.guard import Session, SessionRole
from console.recorded_case import RecordedCase
from procedures.engine.case_view import CaseView, fold
from procedures.engine.events import DeviceAge, Event, Pose, Questioned
from procedures.operator.question import Identity
from procedures.reporting.ending import CLOSING, Ending
from procedures.runs.orders import Claim, OrderReply, Renew, SentOrder, Stop, read_order
from ronna_hw.devices.lifecycle import Lifecycle

UNSEEN_S = 1.0  # host time without a new pose or age of a device, which are reported five times a second
SILENT_S = 1.0  # host time without a line from the engine, which sends one every quarter of a second
SILENT_FILE_S = 3.0  # host time without an event in a run's file, which gets an age every half second
REPLY_S = 3.0  # host time
NO_REPLY = "no reply from the engine; the order may still be carried out"
NOT_RUNNING = "this case is not running: read-only"

SendOrder = Callable[[SentOrder], Awaitable[None]]


class Hub(ChangeNotifier):
    """State of a case, shared by all pages and announced on every change."""

    def __init__(self, folder: Path, now_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self.folder = folder
        self.view = CaseView()
        self.ending: Ending | None = None  # of a closed case, once its folder was asked
        self.has_ended = False  # the engine has closed its end
        self.live = False  # fed by a running engine
        self.review: RecordedCase | None = None  # of a case that this console does not operate
        self._granted = ("", "")  # session and name to which the engine last gave the seat
        self.break_reason = ""  # why nothing more can be read of a case under review
        self._identity: Identity | None = None
        self.pair = b""  # PNG of the stereo head's last pair
        self.pairs = 0  # number of pairs received
        self._paired_s = 0.0
        self._now_s = now_s
        self._heard_s = now_s()
        self._seen_s: dict[str, float] = {}  # host time at which each device was last reported
        self._send: SendOrder | None = None
        self._replies: dict[str, asyncio.Future[str]] = {}

    # State

    def take(self, event: Event) -> None:
        match event.what:
            case Pose(arm=device) | DeviceAge(device=device):
                self._seen_s[device] = self._now_s()
            case Questioned(identity_sha256=digest) as question if digest:
                identity, self._identity = self._identity, None
                if identity is not None and identity.sha256 == digest:
                    event = event.model_copy(update={"what": question.with_identity(identity)})
        self.show(fold(self.view, event))

    def take_identity(self, identity: Identity) -> None:
        """Store the patient's identity for the next question, which has its digest."""
        self._identity = identity

    def show(self, view: CaseView) -> None:
        """Switch to another view: the next one, or one selected for review."""
        self.view = view
        self.notify()

    @property
    def seated_session(self) -> str:
        """Session in the operator's seat, or an empty string if the engine's events report another holder.

        The engine's reply to its claim may arrive before the event that its predecessor has left.
        """
        session, name = self._granted
        return session if self.view.seat is None or self.view.seat.holder == name else ""

    @property
    def aged_view(self) -> CaseView:
        """View of the case, with the age of unreported device readings extended by host time."""
        view = self.view
        unseen_s = {name: self._now_s() - seen_s for name, seen_s in self._seen_s.items()}
        old_s = {name: age_s for name, age_s in unseen_s.items() if age_s > UNSEEN_S}
        if view.outcome or not old_s:
            return view
        devices = {
            name: replace(row, age_s=row.age_s + old_s.get(name, 0.0)) if row.age_s is not None else row
            for name, row in view.devices.items()
        }
        poses = {
            arm: replace(reported, reported_s=reported.reported_s - old_s.get(arm, 0.0))
            for arm, reported in view.poses.items()
        }
        return replace(view, devices=devices, poses=poses)

    def told(self, view: CaseView) -> CaseView:
        """Return a view whose outcome is the ending that the run's folder tells.

        The journal's own word does not say whether a target was missed, nor whether the end was sealed. An
        earlier end of a resumed run keeps it.
        """
        if not view.outcome or view.closings < self.view.closings:
            return view
        if self.ending is None:
            return replace(view, outcome=CLOSING)
        return replace(view, outcome=self.ending.word, ending=self.ending.sentence)

    def take_ending(self, ending: Ending) -> None:
        self.ending = ending
        self.notify()

    def note_heartbeat(self) -> None:
        self._heard_s = self._now_s()

    @property
    def _is_silent(self) -> bool:
        """Whether a line from the engine is overdue."""
        if self.review is None:
            return self.live and self.silent_s > SILENT_S
        rows = self.view.devices.values()
        is_speaking = any(row.age_s is not None and row.seen.state != Lifecycle.CLOSED for row in rows)
        return is_speaking and self.silent_s > SILENT_FILE_S

    @property
    def silent_s(self) -> float:
        """Seconds of host time since the last line from the engine."""
        return self._now_s() - self._heard_s

    @property
    def is_over(self) -> bool:
        """Whether a case under review has ended and its folder is final."""
        return self.review is not None and self.review.is_over

    @property
    def frozen(self) -> str:
        """Reason why the display is frozen, or an empty string if it is not."""
        if self.break_reason:
            return f"{self.break_reason} The data shown is out of date."
        if self.view.outcome:
            return ""
        if self.has_ended or self.is_over:
            return (
                "THE ENGINE HAS ENDED. The data shown is out of date; "
                "the arm may have stopped anywhere on its path."
            )
        if self._is_silent:
            return f"NO DATA FROM THE ENGINE FOR {self.silent_s:.0f} s. The data shown is out of date."
        return ""

    def end(self) -> None:
        self.has_ended = True
        for reply in self._replies.values():
            if not reply.done():
                reply.set_result("the engine has ended")
        self.notify()

    def break_off(self, reason: str) -> None:
        """Note that no more events can be read. `reason` includes the error code and the action."""
        self.break_reason = reason
        self.notify()

    def take_pair(self, picture: bytes) -> None:
        self.pair, self._paired_s = picture, self._now_s()
        self.pairs += 1
        self.notify()

    @property
    def pair_age_s(self) -> float:
        """Seconds of host time since the last image pair arrived."""
        return self._now_s() - self._paired_s

    # Orders

    def connect(self, send: SendOrder) -> None:
        """Route all further orders through this function."""
        self._send = send
        self.live = True
        self.note_heartbeat()

    def reply(self, reply: OrderReply) -> None:
        waiting = self._replies.pop(reply.nonce, None)
        if waiting is not None and not waiting.done():
            waiting.set_result(reply.refused)

    async def order(self, session: Session, content: dict[str, Any]) -> str:
        """Send an order on behalf of a session. Return the reason for a refusal, or an empty string.

        Raises ValueError if it is not an order.
        """
        sent = read_order(json.dumps({"nonce": new_nonce(), **content, "session": session.identifier}))
        if session.role is not SessionRole.OPERATOR:
            return "viewers cannot give orders"
        if self._send is None or self.has_ended:
            return NOT_RUNNING if self._send is None else "the engine has ended"
        if not isinstance(sent.order, Renew | Stop) and not session.orders.allows(self._now_s()):
            return "too many orders in one second"
        reply: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        if sent.nonce in self._replies:
            return "this order was already given"
        sent = sent.model_copy(update={"expires_s": self._now_s() + REPLY_S})
        self._replies[sent.nonce] = reply
        try:
            await self._send(sent)
            refused = await asyncio.wait_for(reply, REPLY_S)
        except (TimeoutError, OSError):
            refused = NO_REPLY
        finally:
            self._replies.pop(sent.nonce, None)
        if isinstance(sent.order, Claim) and not refused:
            self._granted = session.identifier, sent.order.name.strip()
            self.notify()
        return refused


def new_nonce() -> str:
    return secrets.token_urlsafe(12)
