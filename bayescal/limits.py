"""Where the lines are drawn: one place for those who judge and those who report it."""

# what a posterior has to reach to count as converged
RHAT_LIMIT = 1.01
ESS_BULK_LIMIT = 1000.0
ESS_TAIL_LIMIT = 400.0
PARETO_K_LIMIT = 0.7
MOVED_LIMIT = 0.5
"""Smallest share of effective draws among those moved to the exact density."""
EFFECTIVE_LIMIT = 200.0
"""Effective draws of an importance sampler, below which its weights tell nothing, their tail included."""
STUCK_SHARE, STUCK_STEPS = 0.4, 60
"""A walker that stands still for this share of its steps, and for as many, is stuck."""
AGREEMENT = 0.1
"""Largest difference of the two log-evidences, nats."""
TEMPERED_LIMIT = 3.0
"""Standard errors of the difference by which an evidence may miss that of its check by tempering."""

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
BLUNDER = 0.5
"""Probability from which on a pose is called a blunder: more likely than not."""
