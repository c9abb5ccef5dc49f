"""Integrity of a run folder: journal chain, record hashes, seal, and their inspection."""
