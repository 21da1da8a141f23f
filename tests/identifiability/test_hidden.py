"""Bias from unmodelled errors: the part of an error that a posterior attributes to parameters, and reference values."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.density.pose_kernels import KernelInput, PoseFunctions
from bayescal.identifiability.error_size_information import expect_sizes
from bayescal.identifiability.hidden import add, choose_unseen, hide
from bayescal.identifiability.information import information_of_rows, marginalise

SORTS = ("positioning", "smooth")
SIZE, NOISE, N, P = 10e-3, 4e-3, 6, 20


def build_machine(rng, gain=0.5):
    """A linear machine: white rows by 10 parameters of unit prior and by columns of two sorts of errors."""
    travel = rng.uniform(-0.5, 0.5, (P, N))
    place = KernelInput(travel, None)
    bases = [np.broadcast_to(one, (N, *one.shape[1:])) for one in PoseFunctions(SORTS, place, place).list_bases(place)]
    basis = np.concatenate(bases, axis=-1)
    sorts = np.repeat(np.arange(len(SORTS)), [one.shape[-1] for one in bases])
    columns = np.zeros((P, N, N, basis.shape[-1]))
    for leg in range(N):
        columns[:, leg, leg] = basis[leg]
    gains = np.eye(N)[None] * travel[..., None]  # what `positioning` errors do, too
    others = rng.standard_normal((P, N, 4))
    rows = np.concatenate([gain * gains, 0.02 * others], axis=-1).reshape(P * N, -1) / NOISE
    return rows, columns.reshape(P * N, -1) / NOISE, np.tile(sorts, N)


def draw_twins(rows, columns, size, n, rng):
    """Parameters, coefficients and rows of twins."""
    theta, u = rng.standard_normal((n, rows.shape[1])), rng.standard_normal((n, columns.shape[1])) * size
    return theta, u, theta @ rows.T + u @ columns.T + rng.standard_normal((n, len(rows)))


def test_hidden_bias_is_that_of_planted_errors_without_what_rows_show(rng):
    """The estimate without errors is off by what is left of planted ones when all that rows tell of them is removed."""
    rows, columns, sorts = build_machine(rng)
    size = np.array([0.6 * SIZE, 0.8 * SIZE])[sorts]
    allowed, ignored = marginalise(rows, columns * size), information_of_rows(rows, np.ones(rows.shape[1]))
    predicted = hide(allowed.covariance, ignored.covariance)
    _, u, seen = draw_twins(rows, columns, size, 20_000, rng)
    every = np.concatenate([rows, columns * size], axis=1)
    both = seen @ every @ np.linalg.inv(every.T @ every + np.eye(every.shape[1]))
    told = both[:, rows.shape[1] :] * size  # least squares of the errors together with the geometry
    bias = (u - told) @ columns.T @ rows @ ignored.covariance.T
    assert np.allclose(np.sqrt(np.mean(bias**2, axis=0)), predicted, rtol=0.03)
    whole = np.sqrt(np.mean((u @ columns.T @ rows @ ignored.covariance.T) ** 2, axis=0))
    assert (whole > 1.3 * predicted).any()  # seen ones together are no measure of it


def test_estimates_that_allow_for_hidden_errors_hold_the_truth(rng):
    rows, columns, sorts = build_machine(rng)
    size = np.full(2, SIZE)[sorts]
    theta, _, seen = draw_twins(rows, columns, size, 20_000, rng)
    cover = {}
    for name, found in (
        ("allowed", marginalise(rows, columns * size)),
        ("ignored", information_of_rows(rows, np.ones(rows.shape[1]))),
    ):
        white = np.linalg.inv(np.eye(len(rows)) + (columns * size**2) @ columns.T * (name == "allowed"))
        estimate = seen @ white @ rows @ found.covariance
        sd = np.sqrt(np.diag(found.covariance))
        cover[name] = np.mean(np.abs(theta - estimate) < 1.645 * sd, axis=0)
    assert np.allclose(cover["allowed"], 0.9, atol=0.01)
    assert cover["ignored"][:N].max() < 0.7


def test_gain_and_its_error_alike_give_the_closed_form():
    """Without noise y = (κ + c) z leaves a² s² / (a² + s²) of κ's variance a², whatever the data."""
    a, s, z = 0.3, 0.2, np.linspace(-1.0, 1.0, 50)[:, None] * 1e6
    allowed, ignored = marginalise(a * z, s * z), information_of_rows(z, np.full(1, a))
    assert a * hide(allowed.covariance, ignored.covariance)[0] == pytest.approx(a * s / np.hypot(a, s), rel=1e-6)


def test_joint_covariance_is_that_of_twins(rng):
    rows, columns, sorts = build_machine(rng)
    size = np.array([5e-3, 8e-3])[sorts]
    found = marginalise(rows, columns * size)
    theta, u, seen = draw_twins(rows, columns, size, 40_000, rng)
    white = np.linalg.inv(np.eye(len(rows)) + (columns * size**2) @ columns.T)
    both = np.concatenate([theta - seen @ white @ rows @ found.covariance, u / size], axis=1)
    tool = rng.standard_normal((5, both.shape[1]))
    assert np.allclose(np.var(both @ tool.T, axis=0), np.diag(tool @ found.joint @ tool.T), rtol=0.05)


def test_expected_sizes_are_those_that_twins_are_found_to_have(rng):
    """Means of the sizes over twins, each by its own posterior on a grid, and what is expected of them."""
    rows, columns, sorts = build_machine(rng, gain=0.01)
    true, scale = {"positioning": 12e-3, "smooth": 3e-3}, 20e-3
    expected = expect_sizes(rows, columns, sorts, true, {}, scale)
    _, _, seen = draw_twins(rows, columns, np.array(list(true.values()))[sorts], 60, rng)
    prior = rows @ rows.T + np.eye(len(rows))
    grid = np.tan(np.linspace(0.02, 0.98, 25) * np.pi / 2.0) * scale  # even in half-Cauchy probability
    density = np.empty((len(grid), len(grid), len(seen)))
    for i, own in enumerate(grid):
        for k, smooth in enumerate(grid):
            whole = prior + (columns * np.array([own, smooth])[sorts] ** 2) @ columns.T
            root = np.linalg.cholesky(whole)
            density[i, k] = -np.log(np.diag(root)).sum() - 0.5 * (np.linalg.solve(root, seen.T) ** 2).sum(axis=0)
    weight = np.exp(density - density.max(axis=(0, 1)))
    weight /= weight.sum(axis=(0, 1))
    found = [np.einsum("ikt,i->t", weight, grid).mean(), np.einsum("ikt,k->t", weight, grid).mean()]
    assert list(expected.values()) == pytest.approx(found, rel=0.15)
    none = expect_sizes(rows, columns, sorts, dict.fromkeys(true, 0.0), {}, scale)
    assert all(0.0 < none[name] < 0.5 * expected[name] for name in ("positioning",))
    floored = expect_sizes(rows, columns, sorts, dict.fromkeys(true, 0.0), {"positioning": 5e-3}, scale)
    assert floored["positioning"] > 5e-3 > none["positioning"]


def test_unseen_sizes_are_stated_ones_or_shared():
    assert choose_unseen({"positioning": 3e-3, "linear": 1e-3}, ["positioning", "drift"]) == {"positioning": 3e-3}
    shared = choose_unseen({}, ["linear", "positioning", "smooth", "drift"])
    assert set(shared) == {"linear", "positioning", "smooth"}
    assert sum(one**2 for one in shared.values()) == pytest.approx(1e-4)
    assert add({"positioning": 3.0}, {"positioning": 4.0, "smooth": 1.0}) == {"positioning": 5.0, "smooth": 1.0}
    assert add({"positioning": 5.0}, {"positioning": 4.0}, -1.0) == {"positioning": 3.0}
