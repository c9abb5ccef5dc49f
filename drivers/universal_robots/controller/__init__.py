"""What the controller runs: our URScript, with its settings at the head."""
