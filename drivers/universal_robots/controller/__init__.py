"""URScript that the controller runs, with its settings at the head."""
