"""The simulated NDI Polaris Spectra or Vicra: its own process, the unit's bytes, the theatre's scene.

What no public source settles is a named parameter in `parameters.py`; what is not simulated stands in
docs/explanation/not-simulated.md.
"""
