"""Kinds of experiment on one frame."""
