"""Engine of a case: steps, their order, state and progress."""
