"""Robot arms as data."""
