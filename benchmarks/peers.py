"""bayescal beside its peers on the same densities, in one run and one table; one core, one process, one after another.

    python benchmarks/peers.py [--posteriors well misfitting ridge multimodal lengths] [--peers nuts ...]
                               [--seconds 60] [--warm-up 1500] [--draws 500] [--steps 120] [--live 500]
                               [--add]

Five posteriors of the telescope's 6-PUS with 40 simulated poses: ``well``, 60 parameters as in sampling.py;
``misfitting``, the same where the poses have errors of 20 µm that depend on where they are and that no parameter
explains; ``ridge``, the 36 that RR-8096 frees: κ is fixed, only one component of each direction, u_x, is free, and the
data see it by a quadratic; ``multimodal``, the same with twice the tolerance of u_x, so that a mirrored leg counts;
``lengths``, six lengths alone, for the evidence of peers that do not come to an end with more.

- bayescal: exploration, burn-in, four ensembles, all timed; evidence by importance sampling from what was explored.
- NUTS (NumPyro): full mass matrix, started at draws of bayescal's posterior; with and without its warm-up. ``nuts`` has
  NumPyro's defaults, which add to the variances found; ``nuts_exact`` leaves them as they are (an option of NumPyro);
  ``nuts_whitened`` is given the covariance of bayescal's draws as coordinates; ``nuts_straight`` the straight ones
  that bayescal explores and samples in (`jax_straight.py`), whitened by its proposal's main component, with a full mass
  matrix or a diagonal one; the rows of these two carry their warm-up, for a shorter one may do.
- Stretch move (emcee): started there too; its effective draws are an upper bound (it starts at draws of the posterior).
- Nautilus and dynesty: evidence from the prior, cut after so many seconds. dynesty, which takes one vector at a time,
  has the likelihood compiled by JAX.
- `least_squares` (SciPy) with exact derivatives, from draws of the prior: how many reach the best point that anybody
  found.

All seconds are processor time. Other processes on the machine make it longer still, so that bayescal is timed twice
before and twice after each sampler, and ratios are those of neighbours; its draws are the same each time. With
``--add`` a run adds to what the results' file has. What a peer does not reach is in the table as it is.
"""

# ruff: noqa: I001 - peers_sampling sets one core and the number of threads
from __future__ import annotations

import argparse
import json
from functools import partial
from typing import Any

from peers_sampling import compare_rates, run_bayescal, run_nuts, run_stretch, time_bayescal  # first
from peers_evidence import compile_likelihood, run_dynesty, run_least_squares, run_nautilus
from peers_posteriors import BUILD, PlainDensity
from telescope_problem import RESULTS, write_results

import numpy as np


NUTS = {  # whether variances are regularised, whether the mass matrix is full, the coordinates
    "nuts": (True, True, "z"),
    "nuts_exact": (False, True, "z"),
    "nuts_whitened": (True, True, "whitened"),
    "nuts_straight": (True, True, "straight"),
    "nuts_straight_diagonal": (True, False, "straight"),
}
SAMPLERS = (*NUTS, "stretch")
PEERS = (*SAMPLERS, "nautilus", "dynesty", "least_squares")
BESIDE = 2  # runs of bayescal before a sampler, and after it


def compare(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Return the figures of bayescal and of the peers asked for on one posterior."""
    problem, posterior = BUILD[name]()
    density = PlainDensity(posterior)
    ours, found, z = run_bayescal(posterior, options.steps)
    start, best = z[0, 0], float(density(z.reshape(-1, density.n)).max())
    rows: dict[str, dict[str, Any]] = {"bayescal": ours}
    runs = {
        peer: partial(run_nuts, problem, posterior, found, z, options.warm_up, options.draws, *how)
        for peer, how in NUTS.items()
    }
    runs["stretch"] = partial(run_stretch, density, z, options.seconds)
    runs["nautilus"] = partial(run_nautilus, density, options.seconds, 4 * options.live)
    one = compile_likelihood(problem, density, start)
    runs["dynesty"] = partial(run_dynesty, one, density.n, options.seconds, options.live)
    runs["least_squares"] = partial(run_least_squares, density, best, options.seconds)
    for peer in options.peers:
        before = time_bayescal(posterior, options.steps, BESIDE) if peer in SAMPLERS else []
        key = f"{peer}_{options.warm_up}" if peer.startswith("nuts_straight") else peer
        rows[key] = runs[peer]()
        if peer in SAMPLERS:
            beside = before + time_bayescal(posterior, options.steps, BESIDE)
            rows[key] |= compare_rates(ours, rows[key], beside)
        print(name, key, json.dumps(rows[key]), flush=True)
    return {"n_parameters": density.n, **rows}


def report(name: str, rows: dict[str, Any]) -> None:
    """Print a posterior's table."""
    print(
        f"\n{name}\n{'':28}{'min ESS':>9}{'R-hat':>8}{'seconds':>9}{'per s':>9}{'ratio':>9}{'no warm-up':>11}  evidence"
    )
    for peer, row in rows.items():
        if not isinstance(row, dict):
            continue
        ess = row.get("min_bulk_ess", row.get("ess_at_most", np.nan))
        keys = ("max_rhat", "seconds", "ess_per_second", "ratio", "ratio_warm_up_free", "ratio_both_prepared")
        text = "".join(f"{x:9.4g}" for x in (ess, *(row.get(key, np.nan) for key in keys)))
        print(f"{peer:28}{text}  {_describe(row)}", flush=True)


def _describe(row: dict[str, Any]) -> str:
    """Return what a row says of the evidence, or of the fits."""
    if "starts" in row:
        return f"{row['reached']} of {row['starts']} fits reach the best, {row['seconds_each']:.2f} s each"
    if "log_evidence" in row:
        return f"{row['log_evidence']:.2f} ± {row['log_evidence_error']:.2g}"
    if "highest_log_likelihood" in row:
        return f"unfinished, log-likelihood {row['highest_log_likelihood']:.0f} after {row['calls']} calls"
    return ""


def read_results(name: str) -> dict[str, Any]:
    """Return the figures that a results' file has."""
    found = json.loads((RESULTS / f"{name}.json").read_text())
    return {key: found[key] for key in BUILD if key in found}


def main() -> None:
    """Run all, print the tables, write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--posteriors", nargs="*", choices=BUILD, default=list(BUILD))
    parser.add_argument("--peers", nargs="*", choices=PEERS, default=list(PEERS))
    parser.add_argument("--seconds", type=float, default=60.0, help="for each peer that has no end of its own")
    parser.add_argument("--warm-up", type=int, default=1500, help="steps of each NUTS chain")
    parser.add_argument("--draws", type=int, default=500, help="draws of each NUTS chain")
    parser.add_argument("--steps", type=int, default=120, help="of each of bayescal's ensembles")
    parser.add_argument("--live", type=int, default=500, help="points of dynesty; nautilus has four times as many")
    parser.add_argument("--add", action="store_true", help="to what the results' file has")
    parser.add_argument("--name", default="peers", help="of the results' file")
    options = parser.parse_args()
    found = read_results(options.name) if options.add else {}
    for name in options.posteriors:
        found[name] = found.get(name, {}) | compare(name, options)
        report(f"{name}: {found[name]['n_parameters']} parameters", found[name])
    optional = {"dynesty": "dynesty", "nautilus": "nautilus-sampler"}
    packages = ["numpy", "scipy", "emcee", "jax", "numpyro", *(optional[k] for k in options.peers if k in optional)]
    print(write_results(options.name, found, tuple(packages)).name)


if __name__ == "__main__":
    main()
