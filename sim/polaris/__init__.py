"""Simulated NDI Polaris Spectra, Vicra or Vega: a separate process speaking the device's protocol.

`tracker_unit` holds the state, `unit` its parts and vocabulary; `measurement` turns the scene into frames.
`handlers` executes commands, `line` carries bytes, `faults` disturbs unit and line.
Behaviour that no public source settles is a named parameter in `unit/behaviour.py`;
docs/explanation/not-simulated.md lists what is not simulated.
"""
