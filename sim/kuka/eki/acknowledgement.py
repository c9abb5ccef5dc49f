"""The controller's reply to a request."""

from __future__ import annotations

from typing import NamedTuple

from ronna_hw.wire.kuka_eki import AckCode


class Acknowledgement(NamedTuple):
    """A code, and the reason."""

    code: AckCode = AckCode.OK
    text: str = ""


DONE = Acknowledgement()
