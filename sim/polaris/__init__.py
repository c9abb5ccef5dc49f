"""The simulated NDI Polaris Spectra or Vicra: its own process, the unit's bytes, the theatre's scene.

What no public source settles is a named parameter in `parameters.py`.

Not simulated: stray active markers; tools that rotate about a joint; other units than these two. On a
pseudo-terminal data bits, even parity and handshake of the host are not seen, and a break is a flush of both
directions.
"""
