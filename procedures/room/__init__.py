"""Where everything in the room is, as one estimate with covariance, and what each look adds to it."""
