"""Run one case of a stranger's program: `run_case.py PROGRAM CASE`, in a process of its own.

The case passes if the process ends with code 0. Else its last line of output with `MARK` says why.
"""

from __future__ import annotations

import os
import sys
import traceback
from pathlib import Path
from runpy import run_path

MARK = "FAILED: "

if __name__ == "__main__":
    program = Path(sys.argv[1])
    sys.path.insert(0, str(program.parent))
    code = 0
    try:
        run_path(str(program))[sys.argv[2]]()
    except Exception as error:
        (words,) = traceback.format_exception_only(error)[-1:]
        sys.stdout.write(f"\n{MARK}{words.strip().removeprefix('AssertionError: ')}\n")
        code = 1
    sys.stdout.flush()
    os._exit(code)  # threads of some clients never end, and others take half a second for each connection
