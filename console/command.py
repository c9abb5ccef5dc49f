"""`ronna-console`: shows a running or recorded case in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ronna_hw.command_line.messages import tell
from ronna_hw.command_line.terminal import run
from ronna_hw.command_line.viewers_address import BindOption, CertificateOption, KeyOption, viewers_address

app = typer.Typer(
    name="ronna-console",
    help="View a case in a browser, while it runs or afterwards; read-only.",
    epilog="Example: ronna-console runs/20261121T081309-s3-72ab",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


@app.command()
def review(
    folder: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.")],
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0 picks any free port.")] = 0,
    bind: BindOption = None,
    certificate: CertificateOption = None,
    key: KeyOption = None,
) -> None:
    """Serve a page with the full history of a run, until Ctrl-C. Its address contains a key."""
    from console.app import review

    viewers = viewers_address(bind, certificate, key)
    for warning in () if viewers is None else viewers.check():
        tell(f"warning: {warning}")
    review(folder, port, viewers)


def main() -> None:
    run(app)


if __name__ == "__main__":
    main()
