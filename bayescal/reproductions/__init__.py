"""Reproductions of papers: kinds of experiment and claims of one paper each."""
