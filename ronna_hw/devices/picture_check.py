"""Whether images from two cameras arrive as completely as a case needs, as diagnostics. Nothing moves."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ronna_hw.devices.probing import Diagnostic, refusal
from ronna_hw.devices.readiness import TellsReadiness, fact_diagnostics
from ronna_hw.devices.readings import StereoReading, Validity
from ronna_hw.devices.stereo import StereoPair
from ronna_hw.errors import RonnaError

LOOKS_OF_A_CASE = 200  # of five spheres for three trajectories, with some searching
MOST_FAILED_LOOKS = 0.02  # in a case, expected: each ends it


def picture_diagnostics(
    subject: str,
    stereo: StereoPair,
    pairs: int,
    tries: int,
    judged: Callable[[StereoReading], Iterator[Diagnostic]],
) -> Iterator[Diagnostic]:
    """Take this many pairs with configured cameras: do enough arrive complete? The last is `judged`.

    A case makes up for a lost pair: it takes one up to `tries` times.
    """
    whole = 0
    last: StereoReading | None = None
    found: tuple[Diagnostic, ...] = ()
    try:
        with stereo.active():
            for _ in range(pairs):
                last = stereo.grab_pair()
                whole += int(last.validity is Validity.OK)
            if isinstance(stereo, TellsReadiness):
                found = tuple(fact_diagnostics(subject, stereo))  # about these images
    except RonnaError as error:
        yield refusal(f"{subject}pictures", error)
    failed_looks = LOOKS_OF_A_CASE * (1.0 - whole / pairs) ** tries
    yield Diagnostic(
        f"{subject}pictures",
        failed_looks <= MOST_FAILED_LOOKS,
        f"{whole} of {pairs} pairs arrived complete",
        "" if whole == pairs else "Packets are lost: jumbo frames, cable, switch, receive buffer.",
    )
    yield from found
    if last is not None:
        yield from judged(last)
