"""Figures of a study's report, one function each, from tables to a matplotlib figure."""
