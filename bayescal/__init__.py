"""bayescal."""
