"""Simulated measurements of a machine whose truth is known."""
