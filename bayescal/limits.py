"""Where the lines are drawn: one place for those who judge and those who report it."""

from typing import Final

# what a posterior has to reach to count as converged
RHAT_LIMIT = 1.01
ESS_BULK_LIMIT = 400.0
ESS_TAIL_LIMIT = 400.0
PARETO_K_LIMIT = 0.7
ESS_BULK_WANTED = 1000.0
"""Bulk effective sample size below which means are said to be rough: to more than 3 % of a standard deviation."""
MOVED_LIMIT = 0.5
"""Smallest share of effective draws among those moved to the exact density."""
ALIKE_LIMIT = 0.9
"""The same from which on all weights are nearly one, and the shape of their tail says nothing."""
EFFECTIVE_LIMIT = 200.0
"""Effective draws of an importance sampler, below which its weights tell nothing, their tail included."""
STUCK_SHARE, STUCK_STEPS = 0.4, 60
"""A walker that stands still for this share of its steps, and for as many, is stuck."""
HARMLESS = 0.01
"""Share of a posterior that moves no interval that matters: walkers may stand still where no more than that can be."""
AGREEMENT = 0.1
"""Largest difference of the two log-evidences, nats."""
OUT_OF_QUESTION = 50.0
"""Nats behind the best variant from which on a unreliable evidence will do."""
TEMPERED_LIMIT = 3.0
"""Standard errors of the difference by which an evidence may miss that of its check by tempering."""

# what an audit calls determined
IDENTIFIABLE_CONTRACTION = 0.75
"""Contraction from which on a parameter or a direction counts: its standard deviation is at least halved."""
UNIDENTIFIABLE_CONTRACTION = 0.1
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

# what configs may say
LARGEST = 1e9
"""Beyond it, or as close to zero, a number is a slip, and overflows when squared often enough."""
LONGEST = 1e5
"""Millimetres of an arm or of a printer's rod: a hundred metres, beyond which lengths are in another unit."""
LARGEST_FACTOR = 1000.0
"""By which something is varied; the inverse is the smallest."""
LARGEST_KAPPA = 1.0
"""A joint that is deflected by as much as its actuator moves."""
LONGEST_NAME = 100
"""Letters of a name that directories and files are called by."""
LONGEST_TEXT = 2000
"""Letters of a title, a name or what is said of where data come from."""
LARGEST_SEED = 2**63 - 1
"""Of integers in TOML."""
BOUNDS: dict[str, tuple[float, float]] = {
    "um": (1e-4, 1e5),
    "arcsec": (1e-6, 1.296e6),
    "urad": (1e-6, 6.3e6),
    "ppm": (1e-6, 1e5),
    "mm": (0.0, 1e6),
    "deg": (0.0, 360.0),
    "rad": (0.0, 6.3),
    "gpa": (1e-9, 1e5),
    "kg": (1e-6, 1e9),
    "s2": (0.0, 1e4),
}
"""By the unit that a key ends with: the smallest size of what is not zero, and the largest, a kilometre, full turns."""
NOISE_BOUNDS = BOUNDS | {"mm": (1e-7, 1e2), "deg": (1e-9, 360.0), "rad": (1e-11, 6.3)}
"""Of keys with noise in their names: a tenth of a nanometre to a decimetre."""
WIDTH_BOUNDS: dict[str, tuple[float, float]] = {"mm": (1e-7, 1e5), "rad": (1e-9, 7.0), "1": (1e-9, 10.0)}
"""Of what is not known of a parameter, by its unit: a tenth of a nanometre to a hundred metres, a full turn, ten."""
LASTING: Final = ("linear", "positioning", "smooth")
"""Terms of a model error that a geometry imitates."""
UNSEEN_UM = 10.0
"""Root mean square of errors that leave no trace, which pages tell of where nothing is stated of them."""

FEWEST_SETS: Final = 20
"""Simulated data sets from which on ranks of the truth are a verdict: of fewer, ranks of intervals a third as wide as
they should be are mostly within the band of uniform ones.
"""
