"""A recording becomes a report."""
