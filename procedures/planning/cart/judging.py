"""Judges cart positions in separate processes, one per processor."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context

from procedures.planning.cart.place import CartCase, CartMove, Found, Verdict
from procedures.planning.cart.place_map import Judge

Asked = tuple[CartMove, tuple[Found, ...], bool]
CHUNK = 4  # positions per request: a request takes a millisecond, a position some tenths of a second


@contextmanager
def judging(case: CartCase, workers: int | None = None) -> Iterator[Judge]:
    """Judges many positions at once; with `workers` 1 in this process, None uses every processor."""
    count = workers or len(os.sched_getaffinity(0))
    if count == 1:

        def here(asked: Sequence[Asked]) -> Sequence[Verdict]:
            return [case.judged(move, known, search=search) for move, known, search in asked]

        yield here
        return
    # fresh processes: a fork would inherit locks of library threads
    with ProcessPoolExecutor(count, get_context("spawn")) as pool:

        def there(asked: Sequence[Asked]) -> Sequence[Verdict]:
            return list(pool.map(partial(_judged, case), asked, chunksize=CHUNK))

        try:
            yield there
        except BaseException:  # including interruptions: nothing still queued may start
            pool.shutdown(cancel_futures=True)
            raise


def _judged(case: CartCase, asked: Asked) -> Verdict:
    move, known, search = asked
    return case.judged(move, known, search=search)
