"""The line to the host: bytes, frames, commands, and what a bad line does to them."""
