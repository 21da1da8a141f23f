"""bayescal beside its peers on the same densities, in one run and one table; one core, one process, one after another.

    python benchmarks/peers.py [--posteriors well misfitting multimodal] [--seconds 60] [--warm-up 1500] [--draws 500]
                               [--chains 4] [--figaroh PYTHON]

Three posteriors of the telescope's 6-PUS with 40 simulated poses: ``well``, 60 parameters as in sampling.py;
``misfitting``, the same where the poses have errors of 20 µm that depend on where they are and that no parameter
explains; ``multimodal``, the 36 that RR-8096 frees: κ is fixed, and one component of each direction, u_x, mirrors.

- bayescal: exploration, burn-in, four ensembles, all timed; evidence by importance sampling from what was explored.
- NUTS (NumPyro): full mass matrix, started at draws of bayescal's posterior. With and without its warm-up.
- Stretch move (emcee): started there too; its effective draws are an upper bound (see stretch.py).
- Nautilus and dynesty: evidence from the prior, cut after so many seconds; what they say of their error then.
- `least_squares` (SciPy), from draws of the prior: how many reach the best point found by anybody, and at what price.
- figaroh: base parameters of an identification Jacobian by QR beside its rank by singular values, and DETMAX of 300
  candidates by both, where the interpreter of an environment that has it is given.

What a peer does not reach is in the table as it is.
"""

# ruff: noqa: I001 - sampling sets one core and the number of threads
from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import sampling  # first
import stretch
from telescope_problem import SEED, Problem, simulate, write_results

import emcee
import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtri

from bayescal.density.independent_error import ModelError
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior
from bayescal.inference.importance import estimate_by_importance
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector
from bayescal.pose_selection import SelectionProblem, even_candidates, select
from bayescal.pose_selection.criteria import O1
from bayescal.pose_selection.methods import Detmax

SYSTEMATIC = np.array([0.02, 0.02, 0.02, 2e-4, 2e-4, 2e-4])  # mm and rad
MIRRORING = {"a_x": 2.0, "a_y": 2.0, "b_x": 2.0, "b_y": 2.0, "l": 2.0, "u_x": 0.05}  # and their tolerances
PRICE = 0.02  # nats of standard error that evidences are timed to


def build_well() -> tuple[Problem, Posterior]:
    """Return the problem of sampling.py."""
    problem = simulate()
    return problem, problem.posterior()


def build_misfitting() -> tuple[Problem, Posterior]:
    """Return the same machine, measured with errors that no parameter explains."""
    problem = simulate()
    moved = problem.poses.actuators - problem.machine.mechanism.initial_actuator_positions
    wave = np.sin(np.pi * moved / problem.machine.mechanism.actuator_range + np.arange(6))
    error = SYSTEMATIC * wave[:, ::-1]
    poses = replace(
        problem.poses,
        position=problem.poses.position + error[:, :3],
        rotation=matrix_from_rotation_vector(error[:, 3:]) @ problem.poses.rotation,
    )
    problem = replace(problem, poses=poses)
    return problem, problem.posterior()


def build_multimodal() -> tuple[Problem, Posterior]:
    """Return a machine whose directions mirror: κ is known, one component of each and what follows it are not."""
    problem, rng = simulate(), np.random.default_rng(SEED + 7)
    machine = problem.machine
    theta = machine.layout.nominal.copy()
    for symbol, sd in MIRRORING.items():
        theta[machine.layout.index[symbol]] += 0.3 * rng.normal(size=6) * sd
    reached = solve_forward_kinematics(machine, theta, problem.poses.actuators)
    noise = rng.normal(size=(problem.poses.n_poses, 6)) * np.sqrt(np.diagonal(problem.poses.covariance[0]))
    poses = replace(
        problem.poses,
        position=reached.position + noise[:, :3],
        rotation=matrix_from_rotation_vector(noise[:, 3:]) @ reached.rotation,
    )
    problem = Problem(machine, poses, theta)
    priors = {
        name: NormalPrior(prior.mean, MIRRORING[name.partition("[")[0]])
        for name, prior in problem.priors().items()
        if name.partition("[")[0] in MIRRORING
    }
    return problem, Posterior(problem.likelihood(), priors, ModelError(None))


BUILD = {"well": build_well, "misfitting": build_misfitting, "multimodal": build_multimodal}


class PlainDensity:
    """The posterior over standardised parameters z, normalised as bayescal's evidence is."""

    def __init__(self, posterior: Posterior) -> None:
        self.posterior, coordinates = posterior, posterior.coordinates
        self.start, self.free, self.scale = coordinates.start, coordinates.free, coordinates.scale
        self.n_calls = 0

    def theta(self, z: Array) -> Array:
        """Return parameter vectors of z (B, n)."""
        theta = np.tile(self.start, (len(z), 1))
        theta[:, self.free] += self.scale * z
        return theta

    def log_likelihood(self, z: Array) -> Array:
        """Return the log-likelihood (B,); very low where there is no machine."""
        self.n_calls += len(z)
        theta = self.theta(np.atleast_2d(z))
        inside = self.posterior.likelihood.layout.inside(theta)
        theta[~inside] = self.start
        with np.errstate(all="ignore"):
            found = self.posterior.likelihood(theta, np.zeros(6))
        return np.where(inside & np.isfinite(found), found, -1e10)

    def __call__(self, z: Array) -> Array:
        """Return log-likelihood plus log-prior (B,), up to a constant."""
        return self.log_likelihood(z) - 0.5 * np.sum(z**2, axis=1)

    def residuals(self, z: Array) -> Array:
        """Return whitened errors and priors of one vector, of which half the squares are minus the log-density."""
        rows = self.posterior.likelihood.errors(self.theta(z[None]))[0]
        white = np.einsum("pij,pj->pi", self._whitening, np.where(np.isfinite(rows), rows, 1e3)).ravel()
        return np.concatenate([white, z])

    @property
    def _whitening(self) -> Array:
        if not hasattr(self, "_kept"):
            self._kept = np.linalg.inv(np.linalg.cholesky(self.posterior.likelihood.error_covariance(np.zeros(6))))
        return self._kept


def run_bayescal(posterior: Posterior) -> tuple[dict[str, Any], Array]:
    """Return figures of draws and evidence, and the draws in z (ensembles, draws, n)."""
    figures, found, draws = sampling.run_bayescal(posterior)
    begun = time.perf_counter()
    evidence = estimate_by_importance(
        found.straight.log_density, found.proposal, np.random.default_rng(SEED), 4000, PRICE, 400_000
    )
    figures |= {
        "modes": len(found.modes),
        "log_evidence": evidence.log_evidence,
        "log_evidence_error": evidence.standard_error,
        "seconds_evidence": figures["seconds_exploration"] + time.perf_counter() - begun,
    }
    coordinates = posterior.coordinates
    return figures, (draws - coordinates.start[coordinates.free]) / coordinates.scale


def run_nuts(problem: Problem, posterior: Posterior, z: Array, options: argparse.Namespace) -> dict[str, Any]:
    """Return the figures of NUTS with a full mass matrix."""
    sampling.N_CHAINS = options.chains
    starts = np.stack([chain[len(chain) // 2] for chain in z])[: options.chains]
    few = z[:, :: z.shape[1] // 10].reshape(-1, z.shape[-1])
    density, comparison = sampling.choose_density(problem, posterior, few)
    figures, draws = sampling.run_nuts(density, starts, True, options.warm_up, options.draws)
    ours, theirs = (one.reshape(-1, one.shape[-1]) for one in (z, draws))
    shift = np.abs(theirs.mean(axis=0) - ours.mean(axis=0)) / ours.std(axis=0)
    return figures | comparison | {"largest_shift_of_means_in_sd": float(shift.max()), "chains": options.chains}


def run_stretch(density: PlainDensity, z: Array, seconds: float) -> dict[str, Any]:
    """Return the figures of the stretch move from draws of the posterior."""
    n = z.shape[-1]
    start = z.reshape(-1, n)[:: z.shape[0] * z.shape[1] // (4 * n)][: 4 * n]
    sampler = emcee.EnsembleSampler(len(start), n, density, vectorize=True)
    state, begun = emcee.State(start), time.perf_counter()
    while time.perf_counter() - begun < seconds:
        state = sampler.run_mcmc(state, 50, skip_initial_state_check=True)
    spent = time.perf_counter() - begun
    flat = z.reshape(-1, n)
    chain = np.swapaxes(sampler.get_chain(), 0, 1)
    times = stretch.sum_autocorrelation((chain - flat.mean(axis=0)) / flat.std(axis=0))
    ess = chain.shape[0] * chain.shape[1] / times.max()
    return {"seconds": spent, "ess_at_most": float(ess), "ess_per_second": float(ess / spent)}


def run_nautilus(density: PlainDensity, n: int, seconds: float) -> dict[str, Any]:
    """Return nautilus' evidence."""
    from nautilus import Sampler

    density.n_calls, begun = 0, time.perf_counter()
    sampler = Sampler(ndtri, density.log_likelihood, n_dim=n, n_live=2000, vectorized=True, pass_dict=False, seed=1)
    finished = sampler.run(timeout=seconds, verbose=False, discard_exploration=True)
    found = {"seconds": time.perf_counter() - begun, "finished": bool(finished), "calls": density.n_calls}
    return found | {"log_evidence": float(sampler.log_z), "log_evidence_error": float(sampler.n_eff**-0.5)}


def run_dynesty(density: PlainDensity, n: int, seconds: float) -> dict[str, Any]:
    """Return dynesty's evidence."""
    import dynesty

    density.n_calls, begun = 0, time.perf_counter()
    sampler = dynesty.NestedSampler(
        lambda z: float(density.log_likelihood(z[None])[0]), ndtri, n, nlive=500, rstate=np.random.default_rng(1)
    )
    finished = False
    for done in sampler.sample(dlogz=0.1):
        if time.perf_counter() - begun > seconds:
            break
        del done
    else:
        finished = True
        list(sampler.add_live_points())
    found = {"seconds": time.perf_counter() - begun, "finished": finished, "calls": density.n_calls}
    if not finished:
        return found | {"log_evidence": float("nan"), "log_evidence_error": float("inf")}
    results = sampler.results
    return found | {"log_evidence": float(results.logz[-1]), "log_evidence_error": float(results.logzerr[-1])}


def run_least_squares(density: PlainDensity, n: int, best: float, seconds: float) -> dict[str, Any]:
    """Return how many fits from draws of the prior reach the best log-density, and what one takes."""
    rng, begun, values = np.random.default_rng(SEED), time.perf_counter(), []
    while time.perf_counter() - begun < seconds and len(values) < 50:
        try:
            found = least_squares(density.residuals, rng.standard_normal(n), x_scale="jac")
            values.append(float(density(found.x[None])[0]))
        except (ValueError, np.linalg.LinAlgError):
            values.append(-np.inf)
    best = max(best, *values)
    spent = time.perf_counter() - begun
    reached = int(np.sum(np.array(values) > best - 0.5))
    return {"starts": len(values), "reached": reached, "seconds_each": spent / len(values), "draws": 0}


def compare_figaroh(interpreter: Path) -> dict[str, Any]:
    """Return base parameters and DETMAX by both, of the six-hardpoint machine of pose_selection.py.

    The columns of two redundant parameters are put beside the identification Jacobian, so that there is something for a
    base to leave out. DETMAX: 15 of 300 candidates, det(Σ JᵀJ)^(1/L) with all L = 42 parameters, in units of O1's.
    """
    import pose_selection

    domain, rng = pose_selection.build_domain(), np.random.default_rng(SEED)
    candidates = even_candidates(domain, 300)
    problem = SelectionProblem(candidates, O1(), 15)
    begun = time.perf_counter()
    chosen = select(problem, Detmax(), rng)
    seconds_detmax = time.perf_counter() - begun
    blocks = problem.blocks
    information = np.swapaxes(blocks, 1, 2) @ blocks
    jacobian = blocks.reshape(-1, blocks.shape[-1])
    jacobian = np.concatenate([jacobian, jacobian[:, :1] + jacobian[:, 7:8], jacobian[:, 3:4] - jacobian[:, 9:10]], 1)
    begun = time.perf_counter()
    spectrum = np.linalg.svd(jacobian / np.linalg.norm(jacobian, axis=0), compute_uv=False)
    rank = int(np.sum(spectrum > 1e-9 * spectrum[0]))
    seconds_base = time.perf_counter() - begun
    members = [int(k) for k in chosen.index]
    value = float(np.exp(np.linalg.slogdet(information[members].sum(axis=0))[1] / blocks.shape[-1]))
    ours = {"n_base": rank, "seconds_base": seconds_base, "criterion": value, "seconds_detmax": seconds_detmax}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "given.npz"
        np.savez(path, jacobian=jacobian, blocks=information, chosen=15)
        script = Path(__file__).with_name("peers_figaroh.py")
        done = subprocess.run([interpreter, script, path], capture_output=True, text=True, timeout=500, check=False)
    if done.returncode:
        return {"bayescal": ours, "figaroh": {"failed": done.stderr.strip().splitlines()[-1]}}
    theirs = json.loads(done.stdout.strip().splitlines()[-1])
    return {"bayescal": ours, "figaroh": {"n_base": len(theirs.pop("base")), **theirs}}


def report(name: str, rows: dict[str, dict[str, Any]]) -> None:
    """Print a posterior's table."""
    print(f"\n{name}\n{'':14}{'min ESS':>9}{'R-hat':>8}{'seconds':>9}{'per s':>9}{'after warm-up':>15}  evidence")
    for peer, row in rows.items():
        ess = row.get("min_bulk_ess", row.get("ess_at_most", float("nan")))
        rate, later = row.get("ess_per_second", float("nan")), row.get("ess_per_second_after_warm_up", float("nan"))
        rhat, seconds = row.get("max_rhat", float("nan")), row.get("seconds", float("nan"))
        text = f"{peer:14}{ess:9.0f}{rhat:8.3f}{seconds:9.1f}{rate:9.2f}{later:15.2f}   "
        if "log_evidence" in row:
            text += f"{row['log_evidence']:.2f} ± {row['log_evidence_error']:.2g}"
        if "starts" in row:
            text += f"{row['reached']} of {row['starts']} fits reach the best, {row['seconds_each']:.2f} s each"
        print(text, flush=True)


def main() -> None:
    """Run all, print the tables, write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--posteriors", nargs="*", choices=BUILD, default=list(BUILD))
    parser.add_argument("--seconds", type=float, default=60.0, help="for each peer that has no end of its own")
    parser.add_argument("--warm-up", type=int, default=1500)
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--chains", type=int, default=4)
    parser.add_argument("--without", nargs="*", default=[], help="peers to leave out")
    parser.add_argument("--figaroh", type=Path, help="interpreter of an environment with figaroh")
    parser.add_argument("--name", default="peers", help="of the results' file")
    options = parser.parse_args()
    found: dict[str, Any] = {}
    for name in options.posteriors:
        problem, posterior = BUILD[name]()
        density, n = PlainDensity(posterior), posterior.n_parameters
        ours, z = run_bayescal(posterior)
        rows = {"bayescal": ours}
        best = float(density(z.reshape(-1, n)).max())
        peers = {
            "nuts": lambda p=problem, q=posterior, z=z: run_nuts(p, q, z, options),
            "stretch": lambda d=density, z=z: run_stretch(d, z, options.seconds),
            "nautilus": lambda d=density, n=n: run_nautilus(d, n, options.seconds),
            "dynesty": lambda d=density, n=n: run_dynesty(d, n, options.seconds),
            "least_squares": lambda d=density, n=n, b=best: run_least_squares(d, n, b, options.seconds),
        }
        for peer, run in peers.items():
            if peer not in options.without:
                rows[peer] = run()
        if "nuts" in rows:
            after = ours["ess_per_second"] / rows["nuts"]["ess_per_second_after_warm_up"]
            ours |= {"ratio_to_nuts": ours["ess_per_second"] / rows["nuts"]["ess_per_second"], "ratio_after": after}
        report(f"{name}: {n} parameters, {ours['modes']} modes found", rows)
        if "ratio_after" in ours:
            print(f"ratio to NUTS {ours['ratio_to_nuts']:.0f}, its warm-up not counted {ours['ratio_after']:.0f}")
        found[name] = {"n_parameters": n, **rows}
    if options.figaroh is not None:
        found["figaroh"] = compare_figaroh(options.figaroh)
        print(json.dumps(found["figaroh"], indent=1))
    print(write_results(options.name, found, ("numpy", "scipy", "emcee", "jax", "numpyro", "dynesty")).name)


if __name__ == "__main__":
    main()
