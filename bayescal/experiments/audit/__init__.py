"""Identifiability audits."""
