"""Real-time process of the link: answers the controller every cycle, and stops the arm on its own."""
