"""Judges cart positions in separate processes, one per processor."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from procedures.planning.cart.place import CartCase, CartMove, Found, Verdict
from procedures.planning.cart.place_map import Judge
from ronna_hw.host.worker_processes import fresh_processes, results

Asked = tuple[CartMove, tuple[Found, ...], bool]
CHUNK = 4  # positions per request: a request takes a millisecond, a position some tenths of a second


@contextmanager
def judging(case: CartCase, workers: int | None = None) -> Iterator[Judge]:
    """Judges many positions at once; with `workers` 1 in this process, None uses every processor.

    Raises PRC-001 when the processes halt.
    """
    count = workers or len(os.sched_getaffinity(0))
    if count == 1:
        yield lambda asked: _judged(case, asked)
        return
    with fresh_processes(count) as pool:

        def there(asked: Sequence[Asked]) -> Sequence[Verdict]:
            parts = [asked[begin : begin + CHUNK] for begin in range(0, len(asked), CHUNK)]
            judged = results([pool.submit(_judged, case, part) for part in parts])
            return [verdict for part in judged for verdict in part]

        yield there


def _judged(case: CartCase, asked: Sequence[Asked]) -> list[Verdict]:
    return [case.judged(move, known, search=search) for move, known, search in asked]
