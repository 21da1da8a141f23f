"""Experiments on pose selection."""
