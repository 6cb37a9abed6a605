"""A chain becomes the kernel table."""
