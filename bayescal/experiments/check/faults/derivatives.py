"""Wrong derivatives: the model's own against differences of its readings, at machines of the priors."""

from __future__ import annotations

import numpy as np

from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.check.subject import Subject, list_names
from bayescal.numerics.geometry import Array

CHECK, FAULT = "Derivatives", "derivative"
STEP = 1e-3  # prior sd, or of the half width of the workspace; halved, and both extrapolated
WRONG = 1e-3  # of the largest difference along a parameter; right ones agree to 1e-6
MACHINES = 3


def check_derivatives(subject: Subject, rng: np.random.Generator) -> Finding:
    """Return whether readings' derivatives are those of differences, at machines of the priors."""
    worst: dict[str, float] = {}
    for _ in range(MACHINES):
        y, _ = subject.draw_truth(rng)
        for name, value in _compare(subject, subject.measured.adopt(y[None])[0]).items():
            worst[name] = max(worst.get(name, 0.0), value)
    wrong = {name: value for name, value in worst.items() if value > WRONG}
    if not wrong:
        most = max(worst.values(), default=0.0)
        text = f"the model's derivatives are those of differences, to {max(most, 1e-9):.0e} at worst."
        return Finding(CHECK, "", "good", text)
    text = (
        f"the model's derivatives by {list_names(wrong)} are wrong: off by up to {100 * max(wrong.values()):.3g} "
        "%. Correct what the machine's class returns for them; modes rest on it."
    )
    return Finding(CHECK, FAULT, "bad", text)


def _compare(subject: Subject, y: Array) -> dict[str, float]:
    """Return how far the derivative by each coordinate of posterior and pose is off, in its largest difference."""
    posterior, half = subject.measured.anchored, subject.measured.half
    likelihood, m = posterior.likelihood, posterior.n_geometry
    model, given, pose = likelihood.model, likelihood.data.given, likelihood.start
    theta = posterior.theta(y[None])[0]
    here = model.linearise(theta, pose, True, given)
    known = [here.by_parameters @ move for move in posterior.around(y)[1].T] + list(np.moveaxis(here.by_pose, -1, 0))
    names = [*posterior.sampling.names, *(one.name for one in model.coordinates)]
    found = {}
    for k, (name, slope) in enumerate(zip(names, known, strict=True)):

        def read(size: float, k: int = k) -> Array:
            at, where = y.copy(), pose.copy()
            if k < m:
                at[k] += size
            else:
                where[:, k - m] += size * half[k - m]
            return np.asarray(model.read(posterior.theta(at[None])[0], where, given))

        rough, fine = ((read(step) - read(-step)) / (2.0 * step) for step in (STEP, STEP / 2.0))
        expected = (4.0 * fine - rough) / 3.0
        slope = slope if k < m else slope * half[k - m]
        good = np.isfinite(expected) & np.isfinite(slope)
        size = np.max(np.abs(expected), axis=0, initial=0.0, where=good)
        seen = size > 1e-9 * np.max(np.abs(np.nan_to_num(here.values)), axis=0, initial=1e-12)
        off = np.max(np.abs(slope - expected), axis=0, initial=0.0, where=good)
        found[name] = float(np.max(off[seen] / size[seen], initial=0.0))
    return found
