"""Benchmarks against bare baselines and peers, all measured in the same run by `make bench`."""
