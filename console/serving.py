"""`python -m console.serving --feed N RUN`: console process, started by the command that runs a case.

It exits when the engine closes its end, after showing the final state for a while.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from ronna_hw.host.process import limit_to_one_thread

NICER = 10  # than the engine: a page must never cost it a cycle


def main() -> None:
    """Serve one run, as specified on the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--feed", type=int, required=True)
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--viewers", nargs=3, metavar=("ADDRESS", "CERTIFICATE", "KEY"))
    arguments = parser.parse_args()
    os.nice(NICER)
    limit_to_one_thread()
    from console.app import serve
    from ronna_hw.command_line.viewers_address import ViewersAddress
    from ronna_hw.errors import RonnaError

    viewers = None
    if arguments.viewers is not None:
        address, certificate, key = arguments.viewers
        viewers = ViewersAddress(address, Path(certificate), Path(key))
    try:
        serve(arguments.folder, arguments.port, feed=arguments.feed, viewers=viewers)
    except RonnaError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
