"""The default model error in linear-Gaussian code of its own: what intervals should hold, many twins a row.

    python -m benchmarks.truth.linear ROW... --machine hexapod [--sizes 1] [--twins 40] [--seed 7]
                                             [--floor-um 0] [--each] [--out benchmarks/truth/linear.csv]

About the truth, readings and parameters are normal given the sizes of errors:

    e = R d + E Σ_t s_t f_t + ε,    d ~ N(0, 1),    f_t ~ N(0, k_t / c_t),    ε ~ N(0, 1),

R (N, D) what no pose explains of white slopes by the parameters in their tolerances, E the same of the actuators'
errors, c_t the mean of k_t over actuators and poses. Sizes s_t are half-Cauchy, that of independent errors half-normal;
they are drawn by Metropolis's steps, one size at a time. Nothing of it is bayescal's, neither densities nor sampler:
where both hold the truth as often, what they miss is the default's and not the computation's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.linalg import cho_factor, cho_solve

from benchmarks.truth.errors import MATRIX, NONE, ROWS
from benchmarks.truth.machines import MACHINES
from benchmarks.truth.scores import Twin, begin_arguments, draw_twin, hold
from benchmarks.truth.simulated import Array, Simulated, find_determined

TAU, FUNCTIONS = 10e-3, 20e-3  # mm, scales of sizes; or one and two standard deviations of the actuators' noise
STEPS, WARM, EVERY, EACH = 300, 0.2, 20, 25  # steps a size; share left out; draws of parameters at each that is kept
STRIDES = (0.3, 1.0, 2.0)
START = 0.02  # of a drift
N_NEAREST = 400  # poses over which a machine is fitted to one that errs
WAVE = 0.25  # ranges: length of waves of the own position
COVERED = {"cell": np.ones((3, 3)), "axes": np.eye(3)}
"""Machines whose gains are free: which errors of actuators linear in the travel of which others are parameters."""
RANDOM = "random"
LASTING = ("linear", "positioning", "smooth")
ALL = (RANDOM, *LASTING, "drift")


def build_kernels(sorts: tuple[str, ...], z: Array, time: Array, covered: Array | None = None) -> list[Array]:
    """Return k_t / c_t of each actuator between poses, (N, P, P) each, at travels (P, N) in units of the range.

    A sort that ends with a number is that of one actuator alone. What is ``covered`` (N, N), an error of actuator i in
    proportion to the travel of actuator j, is a parameter and no error.
    """
    free = 1.0 - (np.zeros((z.shape[1],) * 2) if covered is None else covered)
    near = np.exp(-0.5 * np.sum((z[:, None] - z[None]) ** 2, axis=-1))
    home, apart = np.exp(-0.5 * np.sum(z**2, axis=1)), z.T[:, :, None] - z.T[:, None, :]
    known = {
        RANDOM: np.eye(len(z))[None],
        "linear": np.einsum("ij,pj,qj->ipq", free, z, z),
        "positioning": free.diagonal()[:, None, None] * z.T[:, :, None] * z.T[:, None, :]
        + WAVE**2 * np.exp(-0.5 * (apart / WAVE) ** 2),
        "smooth": (near - home[:, None] - home + 1.0)[None],
        "drift": (np.minimum.outer(time, time) + START)[None],
    }
    found, every = [], np.arange(1, z.shape[1] + 1)
    for one in sorts:
        sort, _, actuator = one.partition(" ")
        kernel = known[sort] / np.diagonal(known[sort], axis1=1, axis2=2).mean()
        its = every == int(actuator) if actuator else every > 0
        found.append(kernel * its[:, None, None])
    return found


class Problem:
    """A twin about its truth: rows (N,), their slopes (N, D), covariances (N, N) by errors of each sort."""

    def __init__(
        self,
        machine: Simulated,
        theta: Array,
        v: Array,
        values: Array,
        time: Array,
        sorts: tuple[str, ...],
        least: float = 0.0,
        covered: Array | None = None,
    ) -> None:
        across, slope = machine.reduce(theta, v)
        n, q = machine.n_actuators, slope.shape[1]
        self.slope = slope.reshape(-1, theta.size)
        self.centre = (machine.nominal - theta) / machine.sd
        apart = (values - machine.read(theta, v)) / machine.noise
        self.rows = np.einsum("pkr,pk->pr", across, apart).ravel() - self.slope @ self.centre
        shown = np.swapaxes(across[:, :n] / (machine.noise[:n] * machine.lever)[:, None], 1, 2)
        kernels = build_kernels(sorts, 0.5 * machine.travel(v), time, covered)
        size = len(v) * q
        self.errors = np.array(
            [np.einsum("pri,ipq,qsi->prqs", shown, one, shown, optimize=True).reshape(size, size) for one in kernels]
        )
        self.square = self.slope @ self.slope.T
        sensors = float(np.median(machine.noise[:n] * machine.lever))
        self.scales = np.array([max(TAU, sensors) if one == RANDOM else max(FUNCTIONS, 2.0 * sensors) for one in sorts])
        self.random = np.array([one == RANDOM for one in sorts])
        lasting = np.array([one.partition(" ")[0] in LASTING for one in sorts])
        self.floors = 1e-3 * least * lasting / np.sqrt(max(1, lasting.sum()))

    def spread(self, sizes: Array) -> Array:
        """Return the covariance of the rows given the machine."""
        return np.eye(len(self.rows)) + np.tensordot(self.floors**2 + sizes**2, self.errors, axes=1)

    def log_density(self, logarithm: Array) -> float:
        """Return that of the logarithms of the sizes."""
        sizes = np.exp(logarithm)
        factor = cho_factor(self.spread(sizes) + self.square, lower=True, overwrite_a=True)
        value = -0.5 * float(self.rows @ cho_solve(factor, self.rows)) - float(np.log(np.diag(factor[0])).sum())
        ratio = (sizes / self.scales) ** 2
        return value + float(np.sum(np.where(self.random, -0.5 * ratio, -np.log1p(ratio)) + logarithm))

    def draw(self, rng: np.random.Generator) -> Array:
        """Return draws of the parameters about the truth, in their tolerances, (T, D)."""
        here = np.log(np.full(len(self.scales), 0.3 * FUNCTIONS))
        value, draws = self.log_density(here), []
        steps = STEPS * len(here)
        for step in range(steps):
            there = here.copy()
            there[rng.integers(len(here))] += rng.choice(STRIDES) * rng.standard_normal()
            other = self.log_density(there)
            if np.log(rng.random()) < other - value:
                here, value = there, other
            if step >= WARM * steps and step % EVERY == 0:
                draws.append(self.draw_given(np.exp(here), rng))
        return np.concatenate(draws)

    def draw_given(self, sizes: Array, rng: np.random.Generator) -> Array:
        """Return draws given the sizes."""
        gain = np.linalg.solve(self.spread(sizes), self.slope)
        covariance = np.linalg.inv(np.eye(self.slope.shape[1]) + self.slope.T @ gain)
        mean = self.centre + covariance @ (gain.T @ self.rows)
        return mean + rng.standard_normal((EACH, len(mean))) @ np.linalg.cholesky(covariance).T


def find_nearest(machine: Simulated, twin: Twin, rng: np.random.Generator) -> Array:
    """Return the parameters less the true ones, over the tolerances, (D,), of the machine that imitates the twin best.

    That is by least squares over poses of the whole workspace: a part of the error that parameters equal everywhere, as
    the slope of an error is a channel's gain, counts as theirs.
    """
    v = machine.draw_poses(twin.theta, N_NEAREST, rng)
    across, slope = machine.reduce(twin.theta, v)
    n, slope = machine.n_actuators, slope.reshape(-1, twin.theta.size)
    errors = np.einsum("pkr,pk->pr", across[:, :n], twin.error(v) / machine.noise[:n]).ravel()
    return np.linalg.solve(slope.T @ slope + np.eye(slope.shape[1]), slope.T @ errors)


def judge(
    name: str, row: str, size: float, twins: int, seed: int, least: float = 0.0, each: bool = False
) -> dict[str, object]:
    """Return what intervals hold of a row's twins, by all sorts of errors and by random ones alone.

    Functions of the pose together are ``least`` µm large at least; couplings to ``each`` actuator have their own size.
    """
    n = MACHINES[name]().n_actuators
    linear = [f"linear {k}" for k in range(1, n + 1)] if each else ["linear"]
    covered = COVERED.get(name)
    if covered is not None and covered.all():
        linear = []
    every, found = (RANDOM, *linear, "positioning", "smooth", "drift"), []
    for k in range(twins):
        machine, twin = draw_twin(name, row, size, 1000 * seed + k)
        machine.matrix, kept = None, np.flatnonzero(~twin.held)  # the fitted model has no deformation
        right = machine.right_posterior(twin.theta, twin.v[kept])
        directions, scores = find_determined(right), []
        for sorts in (every, (RANDOM,)):
            rows = twin.v[kept], twin.values[kept], kept / len(twin.v)
            problem = Problem(machine, twin.theta, *rows, sorts, least, covered)
            draws = problem.draw(np.random.default_rng([seed, k]))
            nothing = np.zeros(draws.shape[1])
            scores += [hold(draws, nothing), hold(draws @ directions.T, directions @ nothing)]
            if sorts is every:
                nearest = find_nearest(machine, twin, np.random.default_rng([seed, k, 1]))
                of_nearest = [hold(draws, nearest), hold(draws @ directions.T, directions @ nearest)]
                wider = float(np.sqrt(np.mean(draws.var(axis=0) / np.diagonal(right))))
        found.append([100.0 * one for one in scores + of_nearest] + [wider])
    mean, error = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(twins)
    names = ("parameters", "directions", "tau_parameters", "tau_directions", "nearest_parameters", "nearest_directions")
    shares = {
        key: value
        for k, one in enumerate(names)
        for key, value in ((one, mean[k].round(1)), (f"{one}_se", error[k].round(1)))
    }
    return {
        "machine": name,
        "row": row,
        "size": size,
        "floor_um": least,
        "each": each,
        "seed": seed,
        "twins": twins,
        **shares,
        "sd_ratio": mean[6].round(2),
    }


def main() -> None:
    """Judge rows, print them and write them into a table."""
    parser = begin_arguments(__doc__.splitlines()[0], 7)
    parser.add_argument("--floor-um", type=float, default=0.0)
    parser.add_argument("--each", action="store_true")
    given = parser.parse_args()
    rows = given.rows or [one for one in ROWS if one != MATRIX or given.machine.startswith("telescope")]
    for row in rows:
        for size in [0.0] if row == NONE else given.sizes:
            found = judge(given.machine, row, size, given.twins, given.seed, given.floor_um, given.each)
            print(", ".join(f"{key} {value}" for key, value in found.items()), flush=True)
            if given.out is not None:
                write(given.out, found)


def write(path: Path, found: dict[str, object]) -> None:
    """Write one line into a table, instead of what stands there of the same row."""
    keys = ["machine", "row", "size", "floor_um", "each"]
    table = pd.DataFrame([found])
    if path.exists():
        table = pd.concat([pd.read_csv(path), table]).drop_duplicates(keys, keep="last")
    places = {"machine": list(MACHINES).index, "row": ROWS.index, "size": float, "floor_um": float, "each": bool}
    table.sort_values(keys, key=lambda one: one.map(places[str(one.name)])).to_csv(path, index=False)


if __name__ == "__main__":
    main()
