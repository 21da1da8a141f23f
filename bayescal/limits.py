"""Where the lines are drawn: one place for those who judge and those who report it."""

# what a posterior has to reach to count as converged
RHAT_LIMIT = 1.01
ESS_BULK_LIMIT = 1000.0
ESS_TAIL_LIMIT = 400.0
PARETO_K_LIMIT = 0.7
AGREEMENT = 0.1
"""Largest difference of the two log-evidences, nats."""

# what an audit calls determined
INFORMED = 0.75
"""Contraction from which on a parameter or a direction counts: its standard deviation is at least halved."""
DEAD = 0.1
"""Contraction below which hardly anything was learnt."""
NINETY_FIVE = 1.96
"""Standard deviations to either side that hold 95 % of a normal."""

COVERAGE = 0.9
"""Of the intervals that are set against the truth."""
NINETY = 1.6448536269514722
"""Standard deviations to either side that hold 90 % of a normal."""

# what optimisers are told
FAR_AWAY = 1e6
"""Residual where a vector is no machine: finite, since optimisers subtract."""
