"""Real-time process that answers the controller in every cycle and can stop the arm by itself."""
