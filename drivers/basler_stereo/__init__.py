"""Two Basler cameras over GigE Vision, by a client of our own: no vendor library, no root."""

from drivers.basler_stereo.pair import BaslerStereoPair

__all__ = ["BaslerStereoPair"]
