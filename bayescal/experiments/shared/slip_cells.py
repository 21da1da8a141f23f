"""Single cells of a table that are wrong: another row's, another column's, another sign, a shifted point.

All are weighed at once about one machine. A change of reading k at row a by u changes white errors by u times a column
w_ak of that row. With what is known of machine and errors integrated, changes u of some readings gain

    tᵀ u - uᵀ S u / 2,    t_ak = w_akᵀ (e_a - X_a A⁻¹ Xᵀ e),    S_ak,bj = δ_ab w_akᵀ w_aj - w_akᵀ X_a A⁻¹ X_bᵀ w_bj,

X the white slopes of what is standard normal, A = 1 + Xᵀ X: numbers for any exchange of cells, without another fit.
What is given of a row counts by what it does to the readings: they are too large by what the machine reads more with
another value, where it stands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from bayescal.density.linear_gaussian import condition_white, solve_factor
from bayescal.experiments.shared.slip_causes import Cause, format_in_unit
from bayescal.experiments.shared.slip_given import find_moving, list_alike
from bayescal.experiments.shared.slip_rows import RowReadings, VariantReadings, WhitenedRows
from bayescal.experiments.shared.slips import ROWS
from bayescal.machines.readings import Channel
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import join_words

MAX_ROWS: Final = 60  # of which cells are exchanged: those that are farthest off
MAX_CELLS: Final = 1500  # of them
TINY: Final = 1e-9  # of a square, below which nothing is left of it
MAX_NAMED: Final = 3  # best ones of each sort that are fitted
POINTS: Final = {"of the other sign": -1.0, "10 times too large": 0.1, "10 times too small": 10.0}


class Cells(NamedTuple):
    """What changes of single readings gain: t and its S, (P, K) and (P, K, P, K); zero of what does not stand."""

    side: Array
    square: Array

    def gain_one(self, change: Array) -> Array:
        """Return what changes (P, K) of single readings gain, each by itself, (P, K)."""
        own = np.einsum("pkpk->pk", self.square)
        return self.side * change - 0.5 * own * change**2

    def gain_free(self) -> tuple[Array, Array]:
        """Return what a reading that may be anything gains, (P, K), and by how much it is too large then."""
        own = np.einsum("pkpk->pk", self.square)
        change = np.divide(self.side, own, out=np.zeros_like(own), where=own > TINY * own.max(initial=0.0))
        far = self.side * change  # squared distance in what is known of the others
        return 0.5 * far**2 / (1.0 + far) - 0.5 * np.log1p(far), change

    def gain_rows(self, values: Array, places: np.ndarray) -> Array:
        """Return what each two rows gain whose readings of some channels are exchanged, (P, P)."""
        apart = np.nan_to_num(values[:, None, places] - values[None, :, places])  # (P, P, k)
        side, square = self.side[:, places], self.square[:, places][:, :, :, places]
        own = np.einsum("pkpj->pkj", square)
        linear = np.einsum("abk,ak->ab", apart, side) - np.einsum("abk,bk->ab", apart, side)
        each = np.einsum("abk,akj,abj->ab", apart, own, apart) + np.einsum("abk,bkj,abj->ab", apart, own, apart)
        cross = np.einsum("abk,akbj,abj->ab", apart, square, apart)
        return linear - 0.5 * (each - 2.0 * cross)

    def gain_channels(self, values: Array, k: int, j: int) -> Array:
        """Return what each row gains where readings of two channels are exchanged, (P,)."""
        apart = np.nan_to_num(values[:, k] - values[:, j])
        own = np.einsum("pkpj->pkj", self.square)
        square = own[:, k, k] + own[:, j, j] - 2.0 * own[:, k, j]
        return apart * (self.side[:, k] - self.side[:, j]) - 0.5 * apart**2 * square

    def gain_pairs(self, pairs: tuple[np.ndarray, np.ndarray], changes: tuple[Array, Array]) -> Array:
        """Return what pairs of rows, (n,) each, gain by changes (n, K) of the first and of the second, (n,)."""
        (a, b), (first, second) = pairs, changes
        cross = np.einsum("nk,nkj,nj->n", first, self.square[a, :, b], second)
        return self._gain(a, first) + self._gain(b, second) - cross

    def gain_each(self, change: Array) -> Array:
        """Return what a change of all readings of a row gains, of each row by itself, (P, K) to (P,)."""
        return self._gain(np.arange(len(change)), change)

    def _gain(self, rows: np.ndarray, change: Array) -> Array:
        own = np.einsum("nk,nkj,nj->n", change, self.square[rows, :, rows], change)
        return np.asarray(np.sum(self.side[rows] * change, axis=1) - 0.5 * own)


def weigh_cells(white: WhitenedRows, n_channels: int) -> tuple[np.ndarray, Cells]:
    """Return which rows are farthest off by a single reading, (Q,), and what changes of their readings gain.

    Of rows that are white with a column for each channel.
    """
    known, errors = white.rows[..., : white.known], white.rows[..., -1]
    shown = white.rows[..., white.known : white.known + n_channels]
    found = condition_white(known.reshape(-1, white.known), errors.reshape(-1, 1))
    moves = np.einsum("prn,prk->pkn", known, shown)
    p, k, n = moves.shape
    part = solve_factor(found.factor, moves.reshape(-1, n).T).T.reshape(p, k, n)
    side = np.einsum("prk,pr->pk", shown, errors) - part @ found.white[:, 0]
    own = np.einsum("prk,prj->pkj", shown, shown)
    left = np.einsum("pkk->pk", own) - np.sum(part**2, axis=-1)
    far = np.divide(side**2, left, out=np.zeros_like(side), where=left > TINY * np.einsum("pkk->pk", own))
    rows = np.sort(np.argsort(-far.max(axis=1))[: max(2, min(MAX_ROWS, MAX_CELLS // k))])
    chosen, every = part[rows].reshape(-1, n), np.arange(len(rows))
    square = -(chosen @ chosen.T).reshape(len(rows), k, len(rows), k)
    square[every, :, every, :] += own[rows]
    return rows, Cells(side[rows], square)


@dataclass(frozen=True, eq=False)
class CellSearch:
    """Cells of some rows, by their places among all, about one machine."""

    readings: VariantReadings
    rows: np.ndarray
    cells: Cells
    machine: Array  # (D,)
    pose: Array  # (Q, q): of the rows

    def list_causes(self) -> Iterator[tuple[Cause, float]]:
        """Yield the best of each sort with what they gain; each knows of how many it is the best."""
        yield from self._list_rows()
        yield from self._list_channels()
        yield from self._list_points()
        yield from self._list_free()
        yield from self._list_given_rows()
        yield from self._list_given_cells()

    def _name_row(self, row: int) -> str:
        place = int(self.rows[row])
        return f"{place + 1} (pose {str(self.readings.posterior.likelihood.data.poses[place])!r})"

    def _change(self, text: str, changed: dict[tuple[int, int], float], among: int) -> Cause:
        values = self.readings.values.copy()
        for (row, k), value in changed.items():
            values[self.rows[row], k] = value
        return Cause(ROWS, text, RowReadings(values, np.arange(len(values))), among=among)

    def _list_rows(self) -> Iterator[tuple[Cause, float]]:
        """Yield two rows that have each other's readings of a channel, or of a kind of channels."""
        values, channels = self.readings.values[self.rows], self.readings.channels
        kinds = dict[str, tuple[int, ...]]()
        for k, one in enumerate(channels):
            kinds[one.name] = (k,)
            kinds[one.kind] = (*kinds.get(one.kind, ()), k) if one.kind != one.name else (k,)
        groups = {places: name for name, places in kinds.items()}
        upper = np.triu_indices(len(values), 1)
        found = list[tuple[float, int, int, tuple[int, ...]]]()
        for places in groups:
            gains = self.cells.gain_rows(values, np.array(places))[upper]
            found += [(float(gains[i]), int(upper[0][i]), int(upper[1][i]), places) for i in _best(gains)]
        n = len(self.readings.values)
        for gain, a, b, places in sorted(found, reverse=True)[:MAX_NAMED]:
            text = f"rows {self._name_row(a)} and {self._name_row(b)} seem to have each other's {groups[places]}"
            changed = {(a, k): values[b, k] for k in places} | {(b, k): values[a, k] for k in places}
            yield self._change(text, changed, len(groups) * n * (n - 1) // 2), gain

    def _list_channels(self) -> Iterator[tuple[Cause, float]]:
        """Yield a row in which two channels have each other's readings."""
        values, channels = self.readings.values[self.rows], self.readings.channels
        pairs = [(k, j) for k in range(len(channels)) for j in range(k) if channels[k].unit == channels[j].unit]
        found = list[tuple[float, int, int, int]]()
        for k, j in pairs:
            gains = self.cells.gain_channels(values, k, j)
            found += [(float(gains[i]), int(i), k, j) for i in _best(gains)]
        for gain, a, k, j in sorted(found, reverse=True)[:MAX_NAMED]:
            names = join_words([channels[j].name, channels[k].name])
            text = f"readings of {names} seem to be exchanged in row {self._name_row(a)}"
            changed = {(a, k): values[a, j], (a, j): values[a, k]}
            yield self._change(text, changed, len(pairs) * len(self.readings.values)), gain

    def _list_points(self) -> Iterator[tuple[Cause, float]]:
        """Yield a reading of the other sign, or with its decimal point elsewhere."""
        values, channels = self.readings.values[self.rows], self.readings.channels
        found = list[tuple[float, int, int, str]]()
        for words, factor in POINTS.items():
            gains = self.cells.gain_one(np.nan_to_num((1.0 - factor) * values))
            found += [(float(gains.flat[i]), *divmod(int(i), len(channels)), words) for i in _best(gains.ravel())]
        for gain, a, k, words in sorted(found, reverse=True)[:MAX_NAMED]:
            text = f"the reading of {channels[k].name} in row {self._name_row(a)} seems to be {words}"
            changed = {(a, k): POINTS[words] * values[a, k]}
            yield self._change(text, changed, len(POINTS) * self.readings.values.size), gain

    def _list_free(self) -> Iterator[tuple[Cause, float]]:
        """Yield a reading that the others contradict."""
        gains, _ = self.cells.gain_free()
        for i in _best(gains.ravel()):
            a, k = divmod(int(i), len(self.readings.channels))
            columns = np.zeros((*self.readings.values.shape, 1))
            columns[self.rows[a], k] = 1.0
            channel, row = self.readings.channels[k], self._name_row(a)
            text, say = f"{channel.name} in row {row}", partial(_say_off, channel, row)
            cause = Cause(ROWS, text, columns=columns, say=say, among=self.readings.values.size)
            yield cause, float(gains.flat[i])

    # --- what is given of rows ---------------------------------------------------------------------------------------

    @cached_property
    def given(self) -> dict[str, Array]:
        """Columns of what is given that the machine reads, of these rows, (Q,) each."""
        data = self.readings.posterior.likelihood.data
        return {name: data.given[name][self.rows] for name in find_moving(self.readings)}

    def _read(self, rows: np.ndarray, other: dict[str, Array]) -> Array:
        """Return how much more the machine reads at some of these rows (n,) where columns are given otherwise, (n, K).

        Where it reads nothing, NaN.
        """
        data = self.readings.posterior.likelihood.data
        given = {name: value[self.rows[rows]] for name, value in data.given.items()}
        with np.errstate(all="ignore"):
            before, after = (
                self.readings.model.read(self.machine, self.pose[rows], one) for one in (given, given | other)
            )
        read = data.present[self.rows[rows]]
        return np.asarray(np.where(read, after - before, 0.0))

    def _change_given(self, text: str, changed: dict[tuple[int, str], float], among: int) -> Cause:
        data, values = self.readings.posterior.likelihood.data, self.readings.values
        given = {name: data.given[name].copy() for _, name in changed}
        for (row, name), value in changed.items():
            given[name][self.rows[row]] = value
        return Cause(ROWS, text, RowReadings(values, np.arange(len(values)), given=given), among=among)

    def _list_given_rows(self) -> Iterator[tuple[Cause, float]]:
        """Yield two rows that have each other's value of a column, or of all of them."""
        groups = dict.fromkeys([*((name,) for name in self.given), tuple(self.given)]) if self.given else {}
        (a, b), found = np.triu_indices(len(self.rows), 1), list[tuple[float, int, tuple[str, ...]]]()
        for names in groups:
            there, back = ({name: self.given[name][rows] for name in names} for rows in (b, a))
            gains = self.cells.gain_pairs((a, b), (self._read(a, there), self._read(b, back)))
            found += [(float(gains[i]), int(i), names) for i in _best(gains)]
        n = len(self.readings.values)
        for gain, i, names in sorted(found, reverse=True)[:MAX_NAMED]:
            one, other = int(a[i]), int(b[i])
            text = (
                f"rows {self._name_row(one)} and {self._name_row(other)} seem to have each other's {join_words(names)}"
            )
            changed = {(one, name): float(self.given[name][other]) for name in names}
            changed |= {(other, name): float(self.given[name][one]) for name in names}
            yield self._change_given(text, changed, len(groups) * n * (n - 1) // 2), gain

    def _list_given_cells(self) -> Iterator[tuple[Cause, float]]:
        """Yield a row in which two columns of one unit are exchanged, or a value has another sign or decimal point."""
        every, others = np.arange(len(self.rows)), list[tuple[str, dict[str, Array]]]()
        for one, other in list_alike(list(self.given)):
            swapped = {one: self.given[other], other: self.given[one]}
            others.append((f"what is given as {one} and as {other} seems to be exchanged", swapped))
        for name, (words, factor) in product(self.given, POINTS.items()):
            others.append((f"what is given as {name} seems to be {words}", {name: factor * self.given[name]}))
        found = list[tuple[float, int, int]]()
        for k, (_, other_values) in enumerate(others):
            gains = self.cells.gain_each(self._read(every, other_values))
            found += [(float(gains[i]), int(i), k) for i in _best(gains)]
        for gain, row, k in sorted(found, reverse=True)[:MAX_NAMED]:
            text, other_values = others[k]
            changed = {(row, name): float(value[row]) for name, value in other_values.items()}
            said = f"{text} in row {self._name_row(row)}"
            yield self._change_given(said, changed, len(others) * len(self.readings.values)), gain


def _best(gains: Array) -> np.ndarray:
    """Return the places of the largest of gains (n,); of some that are none, fewer."""
    return np.argsort(-gains)[: min(MAX_NAMED, np.count_nonzero(np.isfinite(gains)))]


def _say_off(channel: Channel, row: str, size: Array) -> str:
    amount = format_in_unit(size[0], channel.unit, "+")
    return f"the reading of {channel.name} in row {row} seems to be off by {amount}: check or leave it out"
