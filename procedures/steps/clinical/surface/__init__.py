"""Steps of a case that registers on the scanned skin, in place of those that need markers."""
