"""Log-densities of two tables spliced: rows of one up to some row, and of the other from there on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.density.components import assemble, batches
from bayescal.density.linear_gaussian import whiten
from bayescal.experiments.shared.slip_products import RowProducts
from bayescal.experiments.shared.slip_rows import LinearisedTable, WhitenedRows
from bayescal.numerics.geometry import Array


def weigh_spliced(
    base: LinearisedTable, other: LinearisedTable, zeta: Array, slops: Array, chosen: np.ndarray, step: int
) -> Array:
    """Return the log-density with rows of one table up to each row, and of another from there on, (P,).

    The best of factors (S,) on all noise, at errors ζ (n,). Backwards for a negative step: rows of the other table up
    to that row. Rows of the other table are the chosen ones (Q,), the only ones that count.
    """
    found, q = np.full(len(base.rows), -np.inf), np.arange(len(chosen))
    if base.is_dense and other.is_dense and not (base.lost.any() or other.lost.any()):
        theirs = step * (q - q[:, None]) >= 0
        values = _weigh_whole(base, other, zeta, slops, np.where(theirs, len(base.rows) + q, chosen))
    else:
        mine, common = base.share(other, zeta)
        pairs = (
            (base.whiten(zeta, slop, common=mine), other.whiten(zeta, slop, common=common)) for slop in slops.tolist()
        )
        values = np.stack([_follow(*pair, chosen, step) for pair in pairs]).max(axis=0)
    found[chosen] = values
    return found


def _follow(base: WhitenedRows, other: WhitenedRows, chosen: np.ndarray, step: int) -> Array:
    """Return the log-densities (Q,) by products of rows that one after the other are those of the other table."""
    gram, constant, found = other.total, float(other.constant.sum()), np.empty(len(chosen))
    for k in np.arange(len(chosen))[:: 1 if step > 0 else -1]:
        found[k] = base.weigh(gram, constant)
        gram = gram + base.gram(chosen[[k]]) - other.gram(np.array([k]))
        constant += float(base.constant[chosen[k]] - other.constant[k])
    return found


def _weigh_whole(base: LinearisedTable, other: LinearisedTable, zeta: Array, slops: Array, rows: np.ndarray) -> Array:
    """Return the log-densities (Q,) of rows (Q, Q) of both tables by parts of the covariance of all of them."""
    assert base.shared is not None
    assert other.shared is not None
    shared = replace(
        base.shared, acts=tuple(np.concatenate(both) for both in zip(base.shared.acts, other.shared.acts, strict=True))
    )
    n, r = rows.shape[1], base.errors.shape[1]
    weights, stands = shared.amplitudes(zeta[None]) ** 2, np.concatenate([base.stands, other.stands])
    every = np.concatenate([np.concatenate([-one.slope, one.errors[..., None]], axis=-1) for one in (base, other)])
    every = np.where(stands[:, None, None], every, 0.0)
    constant = np.where(stands, np.concatenate([base.linear.constant, other.linear.constant]), 0.0)
    cells = (rows[:, :, None] * r + np.arange(r)).reshape(len(rows), n * r)
    found, width = np.full(len(rows), -np.inf), every.shape[-1]
    for slop in slops.tolist():
        own = np.concatenate([one.spread(zeta[None], slop) for one in (base, other)], axis=1)
        whole = assemble(own, shared.parts, weights)[0]
        gram, volume = np.empty((len(rows), width, width)), np.empty(len(rows))
        for part in batches(len(rows), n * r):
            mine = cells[part]
            covariance = whole[mine[:, :, None], mine[:, None, :]]
            white, volume[part] = whiten(covariance, every.reshape(-1, width)[mine])
            np.matmul(np.swapaxes(white, -1, -2), white, out=gram[part])
        total = constant[rows].sum(axis=1) + base.log_volume - volume
        found = np.maximum(found, RowProducts(gram, total, width - 1, np.zeros(width - 1)).weigh())
    return found
