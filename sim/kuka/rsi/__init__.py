"""RSI over UDP: telegrams, signal flow and a single program run."""
