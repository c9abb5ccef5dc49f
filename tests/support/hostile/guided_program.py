"""Feeds one parser inputs that libFuzzer makes of good ones, guided by the coverage of our code.

Run as a process of its own, `NAME FOLDER KEPT RUNS SEED`, which libFuzzer ends: with 0 when every input was
read or refused at bounded cost. What was not is left in KEPT; FOLDER is for files that parsers read and for
the inputs that are worth changing, which a following process of the same FOLDER goes on with.
"""

from __future__ import annotations

import sys
from pathlib import Path

import atheris  # type: ignore[import-not-found]
import psutil
from bounded_cost import MEMORY_BYTES, bounded_cost

OURS = ["ronna_hw", "conformance", "drivers", "sim", "procedures", "studies"]
LONGEST_BYTES = 100_000
HANGS_S = 60  # of host time; what takes processor time is refused long before


def main() -> None:
    name, folder, kept, runs, seed = sys.argv[1:]
    with atheris.instrument_imports(include=OURS, enable_loader_override=False):
        from hostile_inputs import parsers, taken
    files, corpus = Path(folder) / f"files-{seed}", Path(folder) / "corpus"
    files.mkdir()
    corpus.mkdir(exist_ok=True)
    parser = parsers(files)[name]
    for number, good in enumerate(parser.good):
        (corpus / str(number)).write_bytes(good)

    def take(data: bytes) -> None:
        with bounded_cost():
            taken(parser, data)

    usual_bytes = psutil.Process().memory_info().rss
    options = {
        "runs": runs,
        "seed": seed,
        "max_len": LONGEST_BYTES,
        "timeout": HANGS_S,
        "rss_limit_mb": (usual_bytes + MEMORY_BYTES) >> 20,
        "artifact_prefix": f"{kept}/",
        "print_final_stats": 1,
    }
    atheris.Setup([sys.argv[0], *(f"-{key}={value}" for key, value in options.items()), str(corpus)], take)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
