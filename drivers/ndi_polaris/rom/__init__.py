"""Tool definitions (.rom): read, write, describe and compare."""
