"""Real-time process that answers the controller every cycle and can stop the arm on its own."""
