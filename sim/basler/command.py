"""`ronna-sim basler`: the two cameras of the stereo head."""

from __future__ import annotations

import ctypes
import os
from typing import Annotated

import typer

from sim.world.background import start_in_background
from sim.world.options import DetachOption, FaultsOption, WorldOption

CAMERAS = 2
FAULTS_OF = ("camera", "room")  # devices whose faults this simulator can have alone

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8  # from malloc.h of the GNU C library
KEPT_BYTES = 256 << 20
LARGEST_KEPT_BYTES = 32 << 20  # the largest value the library accepts


def basler(
    address: Annotated[
        list[str] | None,
        typer.Option(help="IP address of the left, then of the right camera; a free pair by default."),
    ] = None,
    scene: Annotated[str, typer.Option(help="bench, default, mini, or a scene file.")] = "bench",
    faults: FaultsOption = None,
    detach: DetachOption = False,
    world: WorldOption = None,
) -> None:
    """Simulate a pair of GigE Vision cameras, for any client, until terminated."""
    from ipaddress import IPv4Address

    from sim.basler.server import CameraPair
    from sim.world.process import announce, end_with_parent, open_own_control_port, open_world

    if detach and start_in_background("basler"):
        return
    addresses = address or []
    if len(addresses) not in (0, CAMERAS):
        raise typer.BadParameter(
            f"give two addresses, left then right, or none; got {' '.join(addresses)}", param_hint="--address"
        )
    if len(set(addresses)) != len(addresses):
        raise typer.BadParameter("the cameras need two different addresses", param_hint="--address")
    for one in addresses:
        try:
            IPv4Address(one)
        except ValueError as error:
            raise typer.BadParameter(
                f"{one!r} is not an IPv4 address, such as 127.77.0.1", param_hint="--address"
            ) from error
    keep_freed_memory()
    room = open_world(world, scene, faults, FAULTS_OF)
    owner = os.getpid() if world is None else os.getppid()  # of `ronna-sim list`
    pair = CameraPair(
        room, addresses, info=f"ronna-sim, process {owner}"
    )  # forks: before the control port, which is a thread
    control = open_own_control_port(world, room, FAULTS_OF)
    end_with_parent(pair.end)
    announce("basler", control=control, endpoints=pair.endpoints)
    pair.serve()


def keep_freed_memory() -> bool:
    """Make malloc keep freed memory for the next image; return False if unsupported.

    An image needs several arrays of a few megabytes. The C library returns such memory to the kernel when
    freed, and the kernel clears it page by page on the next request. Most images are drawn in `row_bands`;
    this is for the rest: strong defocus, faults on the lens, the images themselves.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    settings = (
        (M_MMAP_THRESHOLD, LARGEST_KEPT_BYTES),
        (M_TRIM_THRESHOLD, KEPT_BYTES),
        (M_ARENA_MAX, 1),  # threads share one arena
    )
    return all([mallopt(name, value) == 1 for name, value in settings])
