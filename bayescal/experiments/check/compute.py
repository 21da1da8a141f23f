"""Computing a check: what the data say, then simulated data sets in tasks."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayescal.errors import NumericalError
from bayescal.experiments.check.faults import Finding, look_at_data
from bayescal.experiments.check.inputs import CheckInputs, Subject
from bayescal.experiments.check.ranks import (
    FALSE_ALARMS,
    POSTERIOR,
    PRIOR,
    Arrays,
    find_band,
    judge_ranks,
    rank_truth,
    tabulate_parameters,
)
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.inference.exploration import explore
from bayescal.inference.importance import estimate_by_importance

DRAWS = 2000  # for the evidence by which the best variant is found


def compute_check(inputs: CheckInputs, run: Run) -> Results:
    """Return what is found of the variants that are checked."""
    tables: dict[str, list[pd.DataFrame]] = {"findings": [], "parameters": [], "ranks": [], "bands": [], "timings": []}
    variants = {}
    for name in _choose(inputs, run):
        findings, own = _check_variant(inputs, name, run)
        passed = not any(one.level == "bad" for one in findings)
        variants[name] = {"passed": passed, "faults": [one.fault for one in findings if one.fault]}
        own["findings"] = pd.DataFrame([vars(one) for one in findings])
        for key, table in own.items():
            table.insert(0, "variant", name)
            tables[key].append(table)
    summary = {
        "name": inputs.config.name,
        "title": inputs.config.title,
        "study": inputs.config.study,
        "data_origin": inputs.origin,
        "data_sets": inputs.config.data_sets,
        "passed": all(one["passed"] for one in variants.values()),
        "variants": variants,
    }
    return Results(summary, {key: pd.concat(parts, ignore_index=True) for key, parts in tables.items() if parts})


# --- which variant -----------------------------------------------------------------------------------------------


def _choose(inputs: CheckInputs, run: Run) -> list[str]:
    """Return the variants that the config names; the best by evidence where it names none."""
    names = list(inputs.subjects)
    if inputs.config.variants or len(names) == 1:
        return names
    found = run.map("variants", _weigh, inputs, {name: name for name in names})
    return [max(names, key=lambda name: float(found[name]["log_evidence"]))]


def _weigh(inputs: CheckInputs, name: str) -> Arrays:
    """Return the log-evidence of a variant, near enough to tell the best; minus infinity where none is found."""
    explore_seed, draw_seed = np.random.SeedSequence([inputs.config.seed, 2]).spawn(2)
    try:
        found = explore(inputs.subjects[name].posterior, explore_seed, max_pilots=0)
        straight, rng = found.straight, np.random.default_rng(draw_seed)
        value = estimate_by_importance(straight.log_density, found.proposal, rng, DRAWS).log_evidence
    except NumericalError:
        value = -np.inf
    return {"log_evidence": np.array(value)}


# --- one variant -------------------------------------------------------------------------------------------------


def _check_variant(inputs: CheckInputs, name: str, run: Run) -> tuple[list[Finding], dict[str, pd.DataFrame]]:
    config, subject = inputs.config, inputs.subjects[name]
    task = (subject, config.draws, config.seed)
    findings, draws, coordinates = run.once(f"data of {name}", look_at_data, task, (Finding,))
    if not len(draws):
        return findings, {}
    tasks = {f"{whence} {k}": f"{whence} {k}" for k in range(config.data_sets) for whence in (PRIOR, POSTERIOR)}
    shared = (subject, np.asarray(draws), np.asarray(coordinates), config.draws, config.seed)
    found = run.map(f"simulated {name}", rank_truth, shared, tasks)
    own = [_judge(subject, whence, found, config.data_sets) for whence in (PRIOR, POSTERIOR)]
    tables = {key: pd.concat([one[key] for _, one in own], ignore_index=True) for key in own[0][1]}
    tables["timings"] = pd.DataFrame(
        {"data_set": list(found), "wall_seconds": [float(one["wall_seconds"]) for one in found.values()]}
    )
    return [*findings, *(finding for finding, _ in own)], tables


def _judge(subject: Subject, whence: str, found: dict[str, Arrays], n: int) -> tuple[Finding, dict[str, pd.DataFrame]]:
    """Return what the data sets from the priors, or from the posterior, say, and their tables."""
    names = subject.posterior.names
    good = {key: one for key, one in found.items() if key.startswith(f"{whence} ") and "rank" in one}
    rank, z, quality = (
        np.stack([one[key] for one in good.values()]) if good else np.empty((0, width))
        for key, width in (("rank", len(names)), ("z", len(names)), ("quality", 2))
    )
    finding = judge_ranks(whence, names, rank, z, quality, n)
    if not good:
        return finding, {"parameters": pd.DataFrame(), "ranks": pd.DataFrame(), "bands": pd.DataFrame()}
    band = find_band(len(rank), FALSE_ALARMS / len(names))
    ranks = pd.DataFrame(rank, columns=list(names))
    ranks.insert(0, "data_set", list(good))
    bands = pd.DataFrame({"simulated_from": whence, "at": band.at, "low": band.low, "high": band.high})
    return finding, {"parameters": tabulate_parameters(whence, names, rank, z), "ranks": ranks, "bands": bands}
