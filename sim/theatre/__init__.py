"""The scene, its shared memory, the one clock, faults, truth."""
