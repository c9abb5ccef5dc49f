"""Faults of the real-time process in RSI's words."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from watched_stream import kuka_faults

from ronna_hw.arm_stream.records import NO_STATE, LinkFault


def test_the_silence_error_names_the_message_that_the_controller_shows() -> None:
    faults, silent = kuka_faults(), replace(NO_STATE, fault=LinkFault.SILENCE)
    told, untold = SimpleNamespace(error=29002), SimpleNamespace(error=0)
    assert "message 29002" in str(faults.error(silent, "EXT", reported=told))
    assert "the controller shows" not in str(faults.error(silent, "EXT", reported=untold))
    assert "the controller shows" not in str(faults.error(silent, "EXT"))
