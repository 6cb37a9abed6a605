"""A file becomes a chain."""
