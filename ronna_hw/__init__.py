"""Contracts and foundations: what drivers, simulators and procedures agree on. Imports none of them."""
