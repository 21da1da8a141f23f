"""What a posterior has to reach to count as converged: one place for those who judge and those who report it."""

RHAT_LIMIT = 1.01
ESS_BULK_LIMIT = 1000.0
ESS_TAIL_LIMIT = 400.0
PARETO_K_LIMIT = 0.7
AGREEMENT = 0.1
"""Largest difference of the two log-evidences, nats."""
