"""Command line under which `ps` and `/proc` list this process, for one that was forked instead of executed.

The kernel reads it from the memory of the process, wherever it was told that it lies. Telling it takes no
privilege, but a kernel that supports checkpoints, as those of all distributions do.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Final

# linux/prctl.h
_PR_SET_MM: Final = 35
_PR_SET_MM_MAP: Final = 14
_SAME_PROGRAM: Final = 0xFFFFFFFF  # as file number of the executable: none

# Fields of /proc/PID/stat as proc(5) numbers them, from 1, in the order of the structure below. They lack
# `brk`, the end of the heap.
_FIRST_AFTER_NAME: Final = 3
_BEFORE_BRK: Final = (26, 27, 45, 46, 47)  # code, data, begin of the heap
_STACK: Final = 28
_ENVIRONMENT: Final = (50, 51)


class _MemoryMap(ctypes.Structure):
    """`struct prctl_mm_map`: where the parts of a process lie in its memory."""

    _fields_ = (
        *((name, ctypes.c_uint64) for name in ("start_code", "end_code", "start_data", "end_data")),
        *((name, ctypes.c_uint64) for name in ("start_brk", "brk", "start_stack", "arg_start", "arg_end")),
        *((name, ctypes.c_uint64) for name in ("env_start", "env_end", "auxv")),
        ("auxv_size", ctypes.c_uint32),
        ("exe_fd", ctypes.c_uint32),
    )


_kept: list[ctypes.Array[ctypes.c_char]] = []  # the kernel reads them as long as the process lives


def show_command_line(words: Sequence[str]) -> bool:
    """Have this process listed under another command line; return False if the kernel cannot."""
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()

    def place(number: int) -> int:
        return int(fields[number - _FIRST_AFTER_NAME])

    text = b"".join(word.encode(errors="surrogateescape") + b"\0" for word in words)
    shown = ctypes.create_string_buffer(text, len(text))
    _kept.append(shown)
    first = ctypes.addressof(shown)
    library = ctypes.CDLL(None)
    library.sbrk.restype = ctypes.c_void_p
    memory = _MemoryMap(
        *map(place, _BEFORE_BRK),
        library.sbrk(0),
        place(_STACK),
        first,
        first + len(text),
        *map(place, _ENVIRONMENT),
        0,
        0,
        _SAME_PROGRAM,
    )
    done: int = library.prctl(
        _PR_SET_MM, _PR_SET_MM_MAP, ctypes.byref(memory), ctypes.c_ulong(ctypes.sizeof(memory)), 0
    )
    return done == 0
