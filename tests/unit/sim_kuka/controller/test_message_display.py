"""The pendant display: each message once with its number, and the client's texts."""

from __future__ import annotations

import pytest

from sim.kuka.pendant import PendantDisplay, rsi_timeout, too_fast


def test_messages_texts_and_acknowledgements_are_each_shown_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    display = PendantDisplay(lambda: 12.5)
    silence, speed = rsi_timeout(100), too_fast("A1", 400.0, 360.0)
    for message, notice in (
        (None, ""),
        (silence, ""),
        (silence, "mind the\nhead"),
        (silence, "mind the\nhead"),
        (None, ""),
        (speed, ""),
    ):
        display.update(message, notice)
    assert capsys.readouterr().err.splitlines() == [
        "pendant at 12.500 s: KSS29002 signal flow: object ETHERNET1 returns error RSITimeout (100 packets)",
        "pendant at 12.500 s: mind the head",
        "pendant at 12.500 s: KSS29002 acknowledged",
        "pendant at 12.500 s: KSS01102 command velocity A1: 400.0 deg/s, at most 360.0",
    ]
