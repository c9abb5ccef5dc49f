"""The stereo head's two cameras in one process, over one world."""

from __future__ import annotations

import sys
from collections.abc import Collection, Sequence

import numpy as np

from sim.basler.addresses import bind_broadcast, bind_pair
from sim.basler.camera.device import Camera
from sim.basler.camera.photographer import Photographer
from sim.basler.camera.timing import TriggerMoments
from sim.basler.control.bootstrap import Identity
from sim.basler.server import ControlServer
from sim.basler.stream.channel import Losses
from sim.theatre.faults import FaultBoard
from sim.theatre.noise import noise
from sim.theatre.world import World

SIDES = ("left", "right")


class CameraPair:
    """Two cameras that serve until they are ended."""

    def __init__(self, world: World, addresses: Sequence[str] = ()) -> None:
        sockets = bind_pair(addresses)
        moments = TriggerMoments(world.clock)
        self._cameras = []
        for side, truth, control in zip(SIDES, (world.scene.left, world.scene.right), sockets, strict=True):
            self._cameras.append(
                Camera(
                    Identity(control.getsockname()[0], truth.serial, side),
                    Photographer(world, truth),
                    world.clock,
                    moments,
                    losses=_losses(world, truth.serial),
                )
            )
        self._server = ControlServer(self._cameras, sockets, bind_broadcast(), _tell)

    @property
    def endpoints(self) -> dict[str, str]:
        """Where clients find the cameras."""
        return {
            side: f"gev://{camera.identity.address}"
            for side, camera in zip(SIDES, self._cameras, strict=True)
        }

    def serve(self) -> None:
        """Answer clients until `end`."""
        for camera in self._cameras:
            camera.open()
        try:
            self._server.serve()
        finally:
            for camera in self._cameras:
                camera.close()

    def end(self) -> None:
        """Make `serve` return soon."""
        self._server.end()


def _losses(world: World, serial: str) -> Losses:
    """Packets that the fault script makes the network lose, the same for a seed."""
    board = FaultBoard(world, "camera")

    def lost(block_id: int, packets: int) -> Collection[int]:
        shares = [float(fault.argument) for fault in board.active("camera_drop")]
        if not shares:
            return ()
        drawn = noise(world.scene.seed, f"stream of camera {serial}", block_id).uniform(0.0, 100.0, packets)
        return set(np.flatnonzero(drawn < max(shares)).tolist())

    return lost


def _tell(message: str) -> None:
    sys.stderr.write(message + "\n")
