"""The stiffness models' closure for batches of machines: the loads of all legs in sums of few products.

With z the direction of a leg, a its lever arm R b*, k_s = (k_n + k_f) / l and c = z · z^0, the loads of the
`equilibrium` module are, as z x ψ = z^0 - c z,

    F = (k_a e + 2 k_s c) z + k_s z x φ - 2 k_s z^0,
    M + a x F = (k_a e + 2 k_s c) a x z + ((k_t - k_n) z · φ + k_s a · φ) z + (k_n - k_s a · z) φ
                + k_s z^0 x (2 a - l z).
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from bayescal.machines.deformations.base import DeformationBasis
from bayescal.machines.models.beam_elements import SYMBOLS, AxialReference, ChainStiffness, compute_chain_stiffness
from bayescal.machines.models.home import BatchHome, home_solver
from bayescal.machines.models.legs import cross_first_axis
from bayescal.machines.models.six_pus import SixPusClosure
from bayescal.machines.models.turns import BatchTurns
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array


class EquilibriumClosure(SixPusClosure):
    """Q W for batches; its pose derivative is that of elastic axial loads alone."""

    def __init__(
        self,
        layout: ParameterLayout,
        position: Array,
        rotation: Array,
        basis: DeformationBasis,
        to_elongation: Array,
        reference: AxialReference,
        external: Array,
    ) -> None:
        super().__init__(layout, position, rotation, basis)
        self._homes, self._turns = home_solver(layout), BatchTurns(rotation)
        self._to_elongation, self._reference = to_elongation, reference
        self._external = external.T[..., None] if external.any() else None

    def evaluate(self, theta: Array) -> Array:
        """Return f, shape (N, P, B)."""
        arm = self._measure(theta)
        parameters = np.ascontiguousarray(theta.T)
        values = {symbol: parameters[self._layout.index[symbol]] for symbol in SYMBOLS}
        length, scale = values["l"], self._reference.scale(values["k2_d"], values["k2_l"])
        chain = compute_chain_stiffness(*values.values()).times(scale)
        self.home = home = self._homes.solve(theta)
        phi = self._turns.evaluate(home.rotation)
        balance = self._scratch.take("balance", 6, *phi.shape[1:])
        self._axial = self._balance_loads(balance, arm, chain, length, home, phi)
        if self._external is not None:
            balance += self._external * scale
        return self._elongate(balance, "closure")

    @abstractmethod
    def _balance_loads(
        self, balance: Array, arm: Array, chain: ChainStiffness, length: Array, home: BatchHome, phi: Array
    ) -> Array:
        """Find minus the sum of all legs' loads (6, P, B); return -k_a per square of the slope, (N, P or 1, B).

        Stiffnesses and lengths have the shape (N, B), φ has (3, P, B); lever arms (3, N, P, B) may be overwritten.
        """

    def _elongate(self, wrench: Array, name: str) -> Array:
        """Return Q times wrenches (6, P, B), shape (N, P, B)."""
        result = self._take(name)
        np.matmul(self._to_elongation, wrench.reshape(len(wrench), -1), out=result.reshape(len(result), -1))
        return result

    def along(self, pose_error: Array) -> Array:
        """Return the pose derivative of the axial loads times e, shape (N, P, B)."""
        load = np.einsum("kipb,kpb->ipb", self._slope, pose_error, out=self._take("scale"))
        load *= self._axial
        wrench = self._scratch.take("wrench", *pose_error.shape)
        np.einsum("kipb,ipb->kpb", self._slope, load, out=wrench)
        return self._elongate(wrench, "work")


class StiffnessClosure(EquilibriumClosure):
    """Loads along the legs as they stand; the slope holds -g = -|g| z and -a x g."""

    def _balance_loads(
        self, balance: Array, arm: Array, chain: ChainStiffness, length: Array, home: BatchHome, phi: Array
    ) -> Array:
        vector, slim = self._slope[:3], (chain.near + chain.far) / length
        across = home.vector * (2.0 * slim / home.length)  # 2 k_s z^0
        inverse = np.reciprocal(self._length, out=self._length)  # lengths are not needed any more
        scale, work = self._take("scale"), self._take("work")
        # along z: (k_a e + 2 k_s c) / |g| = k_a - (k_a l + 2 k_s z^0 · (-g) / |g|) / |g|
        np.einsum("kipb,kib->ipb", vector, across, out=scale)
        scale *= inverse
        scale += (chain.axial * length)[:, None]
        scale *= inverse
        np.subtract(chain.axial[:, None], scale, out=scale)
        np.einsum("kipb,ipb->kpb", self._slope, scale, out=balance)
        # along z once more: its moment by the platform's turn
        np.einsum("kipb,kpb->ipb", vector, phi, out=scale)
        scale *= inverse
        scale *= (chain.torsional - chain.near)[:, None]
        np.einsum("kipb,kpb->ipb", arm, phi, out=work)
        work *= slim[:, None]
        scale -= work
        scale *= inverse
        balance[3:] -= np.einsum("kipb,ipb->kpb", vector, scale)
        # along φ and across it
        np.multiply(inverse, slim[:, None], out=scale)
        balance[:3] += cross_first_axis(np.einsum("kipb,ipb->kpb", vector, scale), phi)
        np.einsum("kipb,kipb->ipb", arm, vector, out=work)
        balance[3:] -= phi * (np.einsum("ipb,ipb->pb", work, scale) + chain.near.sum(axis=0))
        # along z^0 and across it
        balance[:3] += across.sum(axis=1)[:, None]
        np.multiply(inverse, (0.5 * length)[:, None], out=work)
        for k in range(3):
            arm[k] += np.multiply(vector[k], work, out=scale)
        _subtract_moments(balance[3:], across, arm)
        inverse *= inverse
        inverse *= -chain.axial[:, None]
        return inverse


class FixedStiffnessClosure(EquilibriumClosure):
    """Loads along the legs' directions at home, where ψ = z^0 x g / l and e = z^0 · g - l.

    Then F = (k_a e - 2 k_s z^0 · g / l) z^0 + k_s z^0 x φ + 2 k_s g / l. The slope is left with -z^0 and -a x z^0.
    """

    def _balance_loads(
        self, balance: Array, arm: Array, chain: ChainStiffness, length: Array, home: BatchHome, phi: Array
    ) -> Array:
        vector, slim = self._slope[:3], (chain.near + chain.far) / length
        start, lean = home.vector / home.length, 2.0 * slim / length
        scale, force, moment = self._take("scale"), self._take("force", 3), self._slope[3:]
        np.einsum("kipb,kib->ipb", vector, start, out=scale)
        scale *= (lean - chain.axial)[:, None]
        scale -= (chain.axial * length)[:, None]
        np.multiply(vector, -lean[:, None], out=force)
        force += scale * start[:, :, None]
        force += cross_first_axis((slim * start)[:, :, None], phi[:, None])
        np.negative(force.sum(axis=1), out=balance[:3])
        np.negative(cross_first_axis(arm, force, out=moment).sum(axis=1), out=balance[3:])
        balance[3:] -= phi * chain.near.sum(axis=0)
        twist = np.einsum("ib,jib,kib->jkb", chain.torsional - chain.near, start, start)
        balance[3:] -= np.einsum("jkb,kpb->jpb", twist, phi)
        _subtract_moments(balance[3:], slim * start, vector)
        vector[:] = -start[:, :, None]
        cross_first_axis(arm, vector, out=moment)
        return -chain.axial[:, None]


def _subtract_moments(balance: Array, force: Array, arm: Array) -> None:
    """Subtract the sum over legs of w x a from (3, P, B), for covectors w (3, N, B) and arms a (3, N, P, B)."""
    for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
        balance[k] -= np.einsum("ib,ipb->pb", force[m], arm[n])
        balance[k] += np.einsum("ib,ipb->pb", force[n], arm[m])
