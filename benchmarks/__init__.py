"""Measurements against bare baselines and peers, all in the same run. `make bench` runs them."""
