"""Shipped posteriors of readings are what they were before posteriors were merged; see `frozen_densities`."""

import frozen_densities as frozen
import numpy as np
import pytest

FEW = [0, 2, 7, 16]  # the mode, two points about it, one of the prior
CLOSE = {"density": (1e-7, 2e-3), "pointwise": (1e-7, 2e-3), "gradient": (1e-3, 1e-2)}
"""How far numbers may be off, of their size and absolutely: poses are eliminated by steps that end to first order,
2e-3 nats and 1e-2 nats per standard deviation."""
FAR, OF_FAR = 1e3, 1e-3
"""A machine drawn from the prior may leave readings 10⁴ deviations off: 10⁹ nats below the mode second order counts."""
STEPS = 8  # of Newton, to the joint mode of machine and errors
KNOWN = frozen.read_frozen()


@pytest.fixture(scope="module")
def posteriors():
    return frozen.list_posteriors()


@pytest.mark.parametrize(
    "points", [FEW, pytest.param(list(range(frozen.N_POINTS)), marks=pytest.mark.slow)], ids=["some", "all"]
)
@pytest.mark.parametrize("name", KNOWN)
def test_posterior_is_what_it_was(posteriors, name, points):
    entry, posterior = KNOWN[name], posteriors[name]()
    y = frozen.draw_points(name, entry["mode"], entry["scale"])[points]
    found = frozen.measure(name, posterior, y, entry["scale"])
    found["density"][~np.isfinite(found["density"])] = np.nan
    far = np.abs(entry["density"][points]) > FAR * np.abs(entry["density"][0])
    for key, values in found.items():
        expected, (relative, absolute) = entry[key][points], CLOSE[key]
        assert np.array_equal(np.isnan(values), np.isnan(expected)), key
        size, shape = np.abs(expected), (-1, *[1] * (expected.ndim - 1))
        largest = size.max(axis=-1, keepdims=True) if size.ndim > 1 else size
        # a gradient's entries are sums of as much as it is long, and of what cancels at a mode
        size = largest if key == "gradient" else np.where(far.reshape(shape), largest, size)
        of_far = OF_FAR if key != "gradient" else 20.0 * OF_FAR
        allowed = absolute + np.where(far, of_far, relative).reshape(shape) * size
        off = np.abs(values - expected) / allowed
        assert np.nanmax(off) <= 1.0, f"{key}: {np.nanmax(off):.3g} times the tolerance"


def test_all_posteriors_are_frozen(posteriors):
    assert list(posteriors) == list(KNOWN)
    assert len(KNOWN) == 22


@pytest.mark.slow
@pytest.mark.parametrize("name", KNOWN)
def test_mode_is_found_again(posteriors, name):
    entry, posterior = KNOWN[name], posteriors[name]()
    mode, _ = frozen.find_mode(posterior)
    if posterior.linear_geometry(mode) is not None:  # the best geometry at errors that are best whatever the geometry
        for _ in range(STEPS):
            gradient, hessian = posterior.newton(mode)
            mode = mode + np.linalg.solve(-hessian, gradient)
    gained = posterior.log_density(mode[None])[0] - entry["density"][0]
    relative = CLOSE["density"][0]  # of a model that misfits by 10⁶ nats, too
    assert abs(gained) < 2e-3 + relative * abs(entry["density"][0])
