"""The simulated theatre: scene, shared memory, clock, faults, truth."""
