"""A script that operates a case over the console's routes, as anybody may write one."""

from __future__ import annotations

import http.cookiejar
import json
import re
import secrets
import time
import urllib.error
import urllib.request
from typing import Any

from console_clicks import PATIENT

RENEW_S = 1.0


class ConsoleScript:
    """One session."""

    def __init__(self, address: str) -> None:
        self._base = address.partition("/?")[0]
        jar = urllib.request.HTTPCookieProcessor(http.cookiejar.CookieJar())
        self._open = urllib.request.build_opener(jar).open
        self._open(address, timeout=10).close()
        self._renewed_s = 0.0

    def state(self) -> dict[str, Any]:
        if time.monotonic() - self._renewed_s > RENEW_S:
            self._renewed_s = time.monotonic()
            self.order("renew")
        with self._open(f"{self._base}/state", timeout=10) as answer:
            return dict(json.load(answer))

    def order(self, kind: str, **more: Any) -> str:
        """Give an order; returns why it is refused, or nothing."""
        body = json.dumps({"kind": kind, "nonce": secrets.token_urlsafe(9), **more}).encode()
        request = urllib.request.Request(f"{self._base}/orders", body, {"Origin": self._base})
        try:
            with self._open(request, timeout=10) as answer:
                return str(json.load(answer)["refused"])
        except urllib.error.HTTPError as refusal:
            return str(json.load(refusal)["refused"])

    def answer(self, question: dict[str, Any], patient: str = PATIENT, **more: Any) -> str:
        """The first answer, with what is to be read back."""
        moves = re.search(r"moves (\d+(?:\.\d+)?) mm", question["value"])
        typed = {"typed": moves[1] if moves else patient} if question["read_back"] else {}
        first = question["answers"][0]
        return self.order(
            "answer", question=question["question"], answer=first, shown=question["shown"], **typed, **more
        )
