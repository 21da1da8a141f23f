"""Faults that a study may have, each looked for by itself: most are invisible to simulations of its own model."""
