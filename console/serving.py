"""`python -m console.serving --feed N RUN`: the console's process, started by the command that runs a case.

It ends by itself when the engine closes its end, and shows for a while what held then.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

NICER = 10  # than the engine: a page must never cost it a cycle
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def main() -> None:
    """Serve one run; arguments are those that the command line gives."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--feed", type=int, required=True)
    parser.add_argument("--port", type=int, default=0)
    arguments = parser.parse_args()
    os.nice(NICER)
    for name in ONE_THREAD:
        os.environ[name] = "1"
    from console.app import serve
    from ronna_hw.errors import RonnaError

    try:
        serve(arguments.folder, arguments.port, feed=arguments.feed)
    except RonnaError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
