"""The real-time link process: answers the controller every cycle, and stops the arm on its own."""
