"""Every shipped posterior is what it was before eliminations and posteriors were merged; see `frozen_densities`."""

import frozen_densities as frozen
import numpy as np
import pytest

FEW = [0, 2, 7, 16]  # the mode, two points about it, one of the prior
MOVED = {"density": (1e-9, 1e-9), "pointwise": (1e-9, 1e-9), "gradient": (1e-6, 1e-6), "exact": (1e-9, 2e-3)}
ELIMINATED = {"density": (1e-7, 2e-3), "pointwise": (1e-7, 2e-3), "gradient": (1e-3, 1e-2)}
"""How far numbers may be off, of their size and absolutely: where code only moved, and where poses are eliminated by
steps that end to first order, 2e-3 nats and 1e-2 nats per standard deviation."""
FAR, OF_FAR = 1e3, 1e-3
"""A machine drawn from the prior may leave readings 10⁴ deviations off: 10⁹ nats below the mode second order counts."""
READINGS = ("hangprinter", "m2_hexapod_table", "own_machine", "sliding_star", "linear: ", "smooth: ")
"""Posteriors whose poses are eliminated."""
STEPS = 8  # of Newton, to the joint mode of machine and errors
KNOWN = frozen.read_frozen()


@pytest.fixture(scope="module")
def posteriors():
    return frozen.list_posteriors()


def choose_tolerances(name):
    return ELIMINATED if any(one in name for one in READINGS) else MOVED


@pytest.mark.parametrize(
    "points", [FEW, pytest.param(list(range(frozen.N_POINTS)), marks=pytest.mark.slow)], ids=["some", "all"]
)
@pytest.mark.parametrize("name", KNOWN)
def test_posterior_is_what_it_was(posteriors, name, points):
    entry = KNOWN[name]
    posterior, exact = posteriors[name]()
    y = frozen.draw_points(name, entry["mode"], entry["scale"])[points]
    exact = exact if len(points) > frozen.N_EXACT else None
    found = frozen.measure(name, posterior, exact, y, entry["scale"])
    found["density"][~np.isfinite(found["density"])] = np.nan
    tolerances = choose_tolerances(name)
    for key, values in found.items():
        expected = entry[key] if key == "exact" else entry[key][points]
        relative, absolute = tolerances[key]
        size = np.abs(expected)
        if key == "gradient":  # its entries are sums of as much as it is long, and of what cancels at a mode
            size = size.max(axis=1, keepdims=True)
        assert np.array_equal(np.isnan(values), np.isnan(expected)), key
        if key != "exact" and tolerances is ELIMINATED:
            far = np.abs(entry["density"][points]) > FAR * np.abs(entry["density"][0])
            relative = np.where(far, OF_FAR if key != "gradient" else 20.0 * OF_FAR, relative).reshape(
                -1, *[1] * (expected.ndim - 1)
            )
            size = np.where(
                far.reshape(relative.shape), size.max(axis=-1, keepdims=True) if size.ndim > 1 else size, size
            )
        off = np.abs(values - expected) / (absolute + relative * size)
        assert np.nanmax(off) <= 1.0, f"{key}: {np.nanmax(off):.3g} times the tolerance"


def test_all_posteriors_are_frozen(posteriors):
    assert list(posteriors) == list(KNOWN)
    assert len(KNOWN) == 76


@pytest.mark.slow
@pytest.mark.parametrize("name", KNOWN)
def test_mode_is_found_again(posteriors, name):
    entry, posterior = KNOWN[name], posteriors[name]()[0]
    mode, _ = frozen.find_mode(posterior)
    if posterior.linear_geometry(mode) is not None:  # the best geometry at errors that are best whatever the geometry
        for _ in range(STEPS):
            gradient, hessian = posterior.newton(mode)
            mode = mode + np.linalg.solve(-hessian, gradient)
    gained = posterior.log_density(mode[None])[0] - entry["density"][0]
    relative = choose_tolerances(name)["density"][0]  # of a model that misfits by 10⁶ nats, too
    assert abs(gained) < 2e-3 + relative * abs(entry["density"][0])
