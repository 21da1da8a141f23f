"""Machines calibrated from their own readings."""
