"""Simulated photogrammetry of a machine whose truth is known."""
