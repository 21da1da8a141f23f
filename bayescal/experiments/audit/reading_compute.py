"""Computing an audit: what the readings of each set of sensors would tell, to first order about the machine expected.

The information of the readings, poses eliminated, is Λ in units of the priors; what remains unknown of the parameters
has the covariance (1 + Λ)⁻¹.
"""

from __future__ import annotations

import numpy as np

from bayescal.experiments.audit.outlook import Outlook, foresee
from bayescal.experiments.audit.reading_inputs import ReadingAudit
from bayescal.experiments.audit.reading_tables import Prospect, summarise, tabulate
from bayescal.experiments.audit.selection import Selection, select_poses
from bayescal.experiments.audit.sensor_sets import build_sensor_sets
from bayescal.experiments.audit.set_search import FoundSets, search_sets
from bayescal.experiments.audit.set_tables import tabulate_sets
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.readings.knowledge import Knowledge, assess, look_around
from bayescal.identifiability.information import information_of_rows
from bayescal.identifiability.reading_rows import name_tool, see


def compute_readings(inputs: ReadingAudit, run: Run) -> Results:
    """Return what all sets of sensors would tell."""
    names = {name: name for name in inputs.variants}
    found = run.map("variants", _compute_variant, inputs, names, (Prospect, Knowledge, Outlook, Selection))
    tables = tabulate(inputs, found)
    if inputs.sensors is not None:
        tables |= tabulate_sets(inputs, run.once("sets of sensors", _search_sets, inputs, (FoundSets,)))
    return Results(summarise(inputs, tables), tables)


def _compute_variant(inputs: ReadingAudit, name: str) -> Prospect:
    variant = inputs.variants[name]
    posterior = variant.posterior()
    expected = np.zeros(posterior.n_parameters)
    covariance = information_of_rows(see(posterior, expected), np.ones(posterior.n_geometry)).covariance
    knowledge = assess(inputs.config, variant, posterior, expected, covariance)
    at = look_around(variant, posterior, expected, np.random.default_rng([inputs.config.seed, 5]))
    limits = np.array([inputs.limits.get(one, np.inf) for one in knowledge.coordinates])
    return Prospect(
        posterior.prior_sd * np.sqrt(np.diagonal(covariance)),
        knowledge,
        foresee(at, covariance, limits, np.random.default_rng([inputs.config.seed, 11])),
        select_poses(inputs.config, variant, posterior),
    )


def _search_sets(inputs: ReadingAudit) -> FoundSets:
    assert inputs.sensors is not None
    asked, variant = inputs.config.sensor_choice, inputs.sensors
    assert asked is not None
    names, _ = name_tool(variant.model)
    limits = np.array([inputs.limits.get(name, np.inf) for name in names])
    posterior = variant.posterior()
    sets = build_sensor_sets(variant, posterior, inputs.choices, asked.always, limits, inputs.config.seed)
    return search_sets(sets, min(asked.largest or len(inputs.choices), len(inputs.choices)), asked.exhaustive)
