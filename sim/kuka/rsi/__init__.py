"""RSI over UDP: telegrams, signal flow, and one run of the program."""
