"""Execution of the example notebooks: each in its own kernel, over files instead of network ports."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from ronna_hw.arguments import LONGEST_SHOWN
from ronna_hw.bounded_input import parse_json, read_json_bytes
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.host.child_process import end_descendants
from ronna_hw.records import write_atomically
from studies.errors import NOT_A_NOTEBOOK, NOTEBOOK_FAILED, NOTEBOOKS_NOT_INSTALLED

LONGEST_CELL_S = 300.0  # host time; the longest of the examples takes a tenth of it
NOTEBOOK = ".ipynb"


def execute_notebook(path: Path, out: Path) -> Path:
    """Execute a notebook in the folder `out`, write it there with its output, and end what its cells started.

    Raises STU-016 without the extra, STU-017 for a failed cell, STU-018 for another file, CLI-005 for a
    missing one or one in `out`.
    """
    try:
        import nbformat
        from nbclient import NotebookClient
        from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError
    except ImportError as error:
        raise NOTEBOOKS_NOT_INSTALLED(f"notebooks need {error.name}, which is not installed") from error
    if not path.is_file():
        is_there = "is a folder, not a notebook" if path.is_dir() else "does not exist"
        raise PATH_PROBLEM(
            f"{path} {is_there}",
            expected=f"a file NAME{NOTEBOOK}",
            action="Give one or more, such as examples/notebooks/*.ipynb.",
        )
    try:
        content = read_json_bytes(path)
        parse_json(content)["cells"]
        notebook = nbformat.reads(content.decode(), as_version=4)
    except (ValueError, TypeError, KeyError, nbformat.ValidationError) as error:
        raise NOT_A_NOTEBOOK(
            f"{path} is not a notebook, or a damaged one", expected="JSON as Jupyter writes it"
        ) from error
    written = out / path.name
    if written.exists() and written.samefile(path):
        raise PATH_PROBLEM(
            f"{path} would be overwritten by its executed copy",
            expected="another folder than that of the notebook",
            action="Choose another --out.",
        )
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="ronna-") as sockets, end_descendants():
        running: list[tuple[int, str]] = []  # number from 1 and source, of the cells so far
        client = NotebookClient(
            notebook,
            on_cell_execute=lambda cell, cell_index: running.append((cell_index + 1, cell.source)),
            kernel_name="python3",
            timeout=LONGEST_CELL_S,
            resources={"metadata": {"path": str(out)}},
        )
        kernel = client.create_kernel_manager()
        kernel.transport, kernel.connection_file = "ipc", str(Path(sockets, "kernel.json"))
        try:
            client.execute()
        except CellExecutionError as error:
            raise NOTEBOOK_FAILED(
                f"{_name_cell(running, path)} failed", got=f"{error.ename}: {error.evalue}"
            ) from error
        except CellTimeoutError as error:
            raise NOTEBOOK_FAILED(
                f"{_name_cell(running, path)} took too long", limit=f"{LONGEST_CELL_S:g} s"
            ) from error
        except DeadKernelError as error:
            raise NOTEBOOK_FAILED(f"{_name_cell(running, path)} ended its kernel") from error
        except AssertionError as error:  # of nbclient, whose own handler of signals has ended the kernel
            raise KeyboardInterrupt from error
    write_atomically(written, nbformat.writes(notebook).encode())
    return written


def _name_cell(running: Sequence[tuple[int, str]], path: Path) -> str:
    """Name the cell that ran last, with its first line."""
    if not running:
        return f"a cell of {path.name}"
    number, source = running[-1]
    first = next(iter(source.strip().splitlines()), "")
    return f"cell {number} of {path.name} ({first[:LONGEST_SHOWN]})"
