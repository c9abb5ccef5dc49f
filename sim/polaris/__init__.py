"""Simulated NDI Polaris Spectra or Vicra: a separate process that speaks the protocol of the device.

`tracker_unit` holds the state, `unit` its parts and vocabulary; `measurement` turns the scene into frames.
`handlers` executes commands, `line` carries bytes, `faults` disturbs unit and line.
Behaviour that no public source settles is a named parameter in `unit/behaviour.py`;
docs/explanation/not-simulated.md lists what is not simulated.
"""
