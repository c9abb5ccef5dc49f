"""Real-Time Data Exchange: recipes, one session per client, and the server."""
