"""The simulated NDI Polaris Spectra or Vicra: a separate process that speaks the unit's protocol.

Behaviour that no public source settles is a named parameter in `unit/behaviour.py`; what is not simulated is
listed in docs/explanation/not-simulated.md.
"""
