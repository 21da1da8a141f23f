"""A study from its config to its results directory."""
