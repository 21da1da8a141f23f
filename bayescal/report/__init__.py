"""Figures and tables of results; nothing computes with them."""
