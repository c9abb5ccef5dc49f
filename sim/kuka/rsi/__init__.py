"""RSI over UDP: telegrams, replies, signal flow, corrections."""
