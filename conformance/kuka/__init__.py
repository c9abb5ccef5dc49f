"""Cases for KUKA's RSI and EKI: the controller on the wire (K) and its driver (L)."""
