"""Problems of calibration that the tests share: linear ones, a point on lines, Sliding Star."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from function_machines import point_on_lines
from reading_machines import LinearModel
from scipy.stats import chisquare
from sliding_platforms import WORKSPACE, sliding_star

from bayescal.density.calibration.functions import FunctionErrors, Travel
from bayescal.density.calibration.joint_fit import JointFit
from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import ErrorModel, ErrorTerm, ModelErrorTerm, NoiseFactor
from bayescal.density.outliers import NORMAL, Contaminated, Outliers, StudentT
from bayescal.density.posterior import Posterior
from bayescal.density.priors import LogNormalPrior, NormalPrior, Prior, SharePrior, UniformPrior
from bayescal.machines.readings import ReadingModel


def rows_of(nu: float | Outliers) -> Outliers:
    """Return the density of rows with so many degrees of freedom, normal for infinitely many; another as it is."""
    if isinstance(nu, Outliers):
        return nu
    return StudentT(nu) if np.isfinite(nu) else NORMAL


def measurements(values: np.ndarray, sd: np.ndarray | float, correlation: np.ndarray | None = None) -> Measurements:
    """Return readings (P, K) of deviations that broadcast to them, their correlation the same at every pose."""
    names = tuple(f"C{k + 1}" for k in range(len(values)))
    every = None if correlation is None else np.broadcast_to(correlation, (len(values), *correlation.shape))
    return Measurements(names, values, np.broadcast_to(sd, values.shape), correlation=every)


def density(
    model: ReadingModel, data: Measurements, start: np.ndarray | None = None, volume: float = 1.0
) -> CalibrationLikelihood:
    """Return the density of readings, poses looked for from zero by default."""
    start = np.zeros((data.n_poses, len(model.coordinates))) if start is None else start
    return CalibrationLikelihood(model, data, volume, start)


def pointwise(likelihood: CalibrationLikelihood, theta: np.ndarray, tau: float = 0.0, nu: float = np.inf) -> np.ndarray:
    """Return the log-densities (C, P) with the noise as stated, a model error τ beside it."""
    own = np.broadcast_to(likelihood.sd, (len(theta), *likelihood.sd.shape))
    return evaluate_rows(likelihood, theta, own, np.full((len(theta), 1, own.shape[-1]), tau), rows_of(nu))


def evaluate_rows(
    likelihood: CalibrationLikelihood, theta: np.ndarray, own: np.ndarray, tau: np.ndarray, outliers: Outliers = NORMAL
) -> np.ndarray:
    """Return the log-densities (C, P) with deviations (C, P, K) and model errors (C, 1, K) that each machine has."""
    white = likelihood.whiten(own, tau)
    at = likelihood.stand(theta, white)
    found = outliers.weigh(at.square, likelihood.n_spare) + likelihood.offset(white, at)
    return np.where(np.isfinite(found), found, -np.inf)


def unknown_noise(n: int, factors: bool = True, errors: bool = False, scale: float = 1.0) -> tuple[ErrorTerm, ...]:
    """Return noise of n channels in two groups: a factor on the first one's, a model error on the second one's.

    With factors alone the first group is all channels but the last.
    """
    places = np.arange(n)
    factor = NoiseFactor("own", places < n - 1, 0.4)
    model_error = ModelErrorTerm("own", places > 0, scale, "mm")
    return ((factor,) if factors else ()) + ((model_error,) if errors else ())


def line_functions(kernel: str = "smooth", spread: float | None = None, scale: float = 0.1) -> FunctionErrors:
    """Return errors of the first two lines that are functions of their readings, with a scale each."""
    places, lengths = np.array([0, 1]), None if spread is None else LogNormalPrior(1.5, spread)
    travel = Travel("reading", places, np.full(2, 500.0), np.full(2, 200.0))
    group, labels = np.arange(2), ("d[1]", "d[2]")
    return FunctionErrors(
        kernel, 1.5, lengths, places, travel, 3.0, group, np.full(2, scale), 0.3, labels, ("mm", "mm")
    )


def linear_model(rng: np.random.Generator, n: int = 6, q: int = 2, d: int = 3) -> LinearModel:
    """Return readings linear in q coordinates and d parameters."""
    return LinearModel(rng.standard_normal((n, q)), rng.standard_normal((n, d)))


def correlation_of(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return a correlation matrix that is far from the identity."""
    factor = rng.standard_normal((n, n + 1))
    covariance = factor @ factor.T
    deviation = np.sqrt(np.diag(covariance))
    return covariance / deviation[:, None] / deviation


LINE_SD, LINE_WIDTH = 0.05, 1.0
FREE = ("a_x[2]", "a_x[3]", "a_y[3]", "a_x[4]", "a_y[4]", "zero[1]", "zero[2]", "zero[3]", "zero[4]")


def lines_posterior(
    rng: np.random.Generator,
    n_poses: int = 20,
    terms: tuple[ErrorTerm, ...] = (),
    nu: float | Outliers = np.inf,
    correlation: np.ndarray | None = None,
    uniform: bool = False,
    common: bool = False,
    missing: float = 0.0,
    bearing: bool = False,
    commanded: tuple[int, ...] = (),
) -> tuple[CalibrationPosterior, np.ndarray, np.ndarray]:
    """Return the posterior of a point on four lines drawn from its priors, its coordinates y and the poses."""
    model = point_on_lines(4, bearing=bearing)
    k = len(model.channels)
    sd = np.where(np.arange(k) < 4, LINE_SD, 1e-3)
    nominal = dict(zip(model.layout.names, model.layout.nominal, strict=True))
    priors: dict[str, Prior] = {name: NormalPrior(nominal[name], LINE_WIDTH) for name in FREE}
    if uniform:
        priors["a_x[3]"] = UniformPrior(nominal["a_x[3]"] - 2.0, nominal["a_x[3]"] + 2.0)
    shared = {"zero[1,2,3]": ("zero[1]", "zero[2]", "zero[3]")} if common else {}
    for name, members in shared.items():
        priors = {key: prior for key, prior in priors.items() if key not in members}
        priors[name] = NormalPrior(0.0, LINE_WIDTH)
    pose = rng.uniform(-150.0, 150.0, (n_poses, 2))
    empty = measurements(np.zeros((n_poses, k)), sd, correlation)
    blank = Posterior(density(model, empty, pose, 9e4), priors, ErrorModel(terms, rows_of(nu)), {}, shared)
    y = rng.standard_normal(blank.n_parameters)
    values = simulate(blank, y, pose, rng)
    lack = rng.random(n_poses) < missing  # one reading each: three lines left still tell where the point is
    values[lack, rng.integers(0, 4, n_poses)[lack]] = np.nan
    data = measurements(values, sd, correlation)
    if commanded:
        data = replace(data, commanded=np.tile(np.isin(np.arange(k), commanded), (n_poses, 1)))
    return replace(blank, likelihood=density(model, data, pose, 9e4)), y, pose


def simulate(posterior: CalibrationPosterior, y: np.ndarray, pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return readings (P, K) of the machine y (n,) at poses, as its density says."""
    likelihood, outliers = posterior.likelihood, posterior.errors.tails(posterior.zeta(y[None]))
    own, tau = posterior.likelihood.noise(posterior.errors, posterior.zeta(y[None]))
    covariance = own[0][:, :, None] * likelihood.correlation * own[0][:, None]
    covariance = covariance + np.einsum("pk,kl->pkl", np.broadcast_to(tau[0] ** 2, own[0].shape), np.eye(own.shape[-1]))
    noise = (np.linalg.cholesky(covariance) @ rng.standard_normal((*own[0].shape, 1)))[..., 0]
    noise *= np.sqrt(outliers.draw_wide((1, len(noise), 1), rng)[0])
    return likelihood.model.read(posterior.theta(y[None])[0], pose) + noise


def star_problem(seed: int = 3, n_poses: int = 10) -> tuple[CalibrationLikelihood, np.ndarray]:
    """Return the density of Sliding Star's carriages and angles at poses, and machines (4, D) close to the true one."""
    whole, rng = sliding_star(), np.random.default_rng(seed)
    chosen = np.arange(8)
    model = whole.pick(chosen)
    sd = np.repeat([1e-3, 5e-6], 4)
    theta = whole.layout.nominal + np.where(np.array(whole.layout.units) == "mm", 0.1, 1e-4) * rng.standard_normal(34)
    pose = replace(WORKSPACE, n_poses=n_poses).draw(whole, rng)
    data = measurements(model.read(theta, pose) + sd * rng.standard_normal((n_poses, 8)), sd)
    near = theta + np.where(np.array(whole.layout.units) == "mm", 1e-2, 1e-5) * rng.standard_normal((4, 34))
    return density(model, data, pose, 200.0), near


def fit_jointly(posterior: CalibrationPosterior, y: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates (n,) and poses (P, q) of least squares at the noise of y, from poses (P, q)."""
    m = posterior.n_geometry
    found, stood = JointFit(posterior.likelihood, posterior.sampling, posterior.errors, y[m:]).run(y[:m], pose)
    return np.append(found, y[m:]), stood


def climb(posterior: CalibrationPosterior) -> tuple[np.ndarray, np.ndarray]:
    """Return the mode by Newton's steps from the least-squares solution, and the root of the covariance there."""
    y = posterior.refine_geometry(posterior.least_squares_start())
    for _ in range(30):
        gradient, hessian = posterior.gradient(y)
        step = np.linalg.solve(-hessian, gradient)
        y = y + step / max(1.0, float(np.abs(step).max()))
        if np.abs(step).max() < 1e-6:
            break
    return y, np.linalg.cholesky(np.linalg.inv(-hessian))


def judge_ranks(ranks: np.ndarray, highest: int) -> float:
    """Return the p-value of ranks, from zero to the highest, against a uniform distribution, by chi-square."""
    counts = np.bincount(ranks.ravel() * 10 // (highest + 1), minlength=10)
    return float(chisquare(counts).pvalue)


MIXED = np.array([[1.0, 0.6, 0.1, 0.0], [0.6, 1.0, 0.2, -0.3], [0.1, 0.2, 1.0, 0.5], [0.0, -0.3, 0.5, 1.0]])
LINE_CASES = {
    "as stated": {},
    "factor": {"terms": unknown_noise(4)},
    "model error": {"terms": unknown_noise(4, False, True, 0.1)},
    "factor and model error": {"terms": unknown_noise(4, True, True, 0.1)},
    "robust": {"nu": 4.0},
    "robust, factor and model error": {"nu": 3.0, "terms": unknown_noise(4, True, True, 0.1)},
    "correlated": {"correlation": MIXED},
    "correlated, factor and model error": {"correlation": MIXED, "terms": unknown_noise(4, True, True, 0.1)},
    "uniform": {"uniform": True},
    "common": {"common": True, "uniform": True},
    "missing": {"missing": 0.5},
    "commanded": {"commanded": (0, 2), "terms": unknown_noise(4, True, True, 0.1)},
    "commanded by more than coordinates": {"commanded": (0, 1, 2), "correlation": MIXED},
    "a circle": {"bearing": True, "terms": unknown_noise(5, True, True, 0.1)},
    "functions": {"terms": (line_functions(),)},
    "functions of a free length": {"terms": (line_functions("smooth", 0.3),)},
    "functions, factor and model error": {"terms": (*unknown_noise(4, True, True, 0.1), line_functions("linear"))},
    "functions, robust": {"nu": 4.0, "terms": (line_functions("quadratic"),), "n_poses": 30},
    "functions, robust, factor and model error": {
        "nu": 3.0,
        "terms": (line_functions(), *unknown_noise(4, True, True, 0.1)),
        "correlation": MIXED,
        "missing": 0.3,
    },
    "contaminated": {"nu": Contaminated(SharePrior(0.1)), "terms": unknown_noise(4)},
    "functions, contaminated": {
        "nu": Contaminated(SharePrior(0.02)),
        "terms": (line_functions("quadratic"),),
        "n_poses": 30,
    },
    "everything": {
        "terms": unknown_noise(4, True, True, 0.1),
        "nu": 5.0,
        "correlation": MIXED,
        "uniform": True,
        "common": True,
        "missing": 0.3,
    },
}
"""Keys of `lines_posterior`: what is unknown of the noise, common errors, outliers, and of which readings."""
