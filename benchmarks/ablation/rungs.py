"""What inference does beyond Laplace's approximation, importance sampling and ensembles, each switched off by itself.

A rung is attributes of modules or classes and what stands there when it is off. Nothing of the package knows of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bayescal.experiments.shared import estimate
from bayescal.experiments.study.readings import ReadingSubject
from bayescal.inference import bridge, conditional, exploration, mode, peaks, reparameterisation, ridges
from bayescal.inference.chain_checks import TailShare
from bayescal.inference.proposal import proposal_from_draws

NO_DIFFERENCE = (1.0, 0.0)
"""Share of draws that count by a finer density, and what it leaves out, where there is none."""

type Place = tuple[Any, str]
"""A module or class, and the name of its attribute."""


@dataclass(frozen=True)
class Rung:
    """One thing that inference does.

    Attributes
    ----------
    name, module : str
        Module of `bayescal.inference` in which it is.
    off : dict of Place to Any
        What stands at attributes when it is off: functions or constants.
    seen : tuple of Place
        Functions one of which is called wherever a constant matters; those that are replaced by default.
    says : str
        Of a check that changes no draw, the words by which its problems are known.
    """

    name: str
    module: str
    off: dict[Place, Any]
    seen: tuple[Place, ...] = ()
    says: str = ""
    several: bool = False
    """Whether it matters only where there are several modes."""
    idle: Callable[[Any, tuple[Any, ...]], bool] | None = None
    """Of a result and what it was made from, whether it changed nothing; by default where it is what was given."""

    @property
    def watched(self) -> tuple[Place, ...]:
        """Functions whose calls show that it was reached."""
        return self.seen or tuple(self.off)

    @contextmanager
    def switched_off(self) -> Iterator[None]:
        """Compute without it."""
        with patched(self.off):
            yield


@contextmanager
def patched(values: dict[Place, Any]) -> Iterator[None]:
    """Let attributes have other values."""
    before = {place: getattr(*place) for place in values}
    for (owner, name), value in values.items():
        setattr(owner, name, value)
    try:
        yield
    finally:
        for (owner, name), value in before.items():
            setattr(owner, name, value)


@dataclass
class Watch:
    """Which functions changed something, and how many CPU seconds they took, what they call among it."""

    changed: set[Place] = field(default_factory=set)
    seconds: dict[Place, float] = field(default_factory=dict)

    @contextmanager
    def watching(self, rungs: Sequence[Rung]) -> Iterator[None]:
        """Look at all functions of rungs."""
        idle = {place: rung.idle or is_what_was_given for rung in rungs for place in rung.watched}
        with patched({place: self._wrap(place, getattr(*place), one) for place, one in idle.items()}):
            yield

    def _wrap(
        self, place: Place, function: Callable[..., Any], idle: Callable[[Any, tuple[Any, ...]], bool]
    ) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            began = time.process_time()
            found = function(*args, **options)
            self.seconds[place] = self.seconds.get(place, 0.0) + time.process_time() - began
            if not idle(found, args):
                self.changed.add(place)
            return found

        return call

    def reached(self, rung: Rung) -> bool:
        """Return whether a rung changed anything."""
        return any(place in self.changed for place in rung.watched)

    def spent(self, rung: Rung) -> float:
        """Return the CPU seconds of what a rung replaces."""
        return sum(self.seconds.get(place, 0.0) for place in rung.watched)


def is_what_was_given(found: Any, args: tuple[Any, ...]) -> bool:
    """Return whether a result is nothing, no change, or one of the arguments."""
    first = found[0] if isinstance(found, tuple) and len(found) else found
    is_nothing = found is None or found is True or (isinstance(found, list) and not found)
    return is_nothing or (isinstance(first, float) and found == NO_DIFFERENCE) or any(first is one for one in args)


# --- what stands there when a rung is off ----------------------------------------------------------------------------


def _keep(found: Any, *_: Any, **__: Any) -> Any:
    return found


def _keep_second(_: Any, found: Any, *__: Any) -> Any:
    return found


def _keep_both(first: Any, second: Any, *_: Any) -> tuple[Any, Any]:
    return first, second


def _nothing(*_: Any, **__: Any) -> None:
    return None


def _none(*_: Any, **__: Any) -> list[Any]:
    return []


def _straighten_alone(posterior: Any, at: Any) -> reparameterisation.Reparameterisation:
    """Do not stretch geometry with the errors' sizes; the map by closed form stays where there is one."""
    found = reparameterisation.straighten(posterior, at)
    return found if found.conditional is not None else replace(found, blocks=(), rest=np.empty(0), tau=np.empty(0))


def _jump_along_alone(self: mode.NewtonSearch, y: Any) -> list[Any]:
    return mode._look_along(self.posterior, y) if self.looks_along else []


def _propose_plainly(straight: Any, peaks_: Any) -> Any:
    del straight
    return peaks.proposal_from_peaks(peaks_, exploration.CONDITIONAL_DOF)


RUNGS = (
    # search for modes
    Rung("starts from the prior", "mode", {(mode, "_climb_scattered"): _none}),
    Rung("mirrored coordinates", "mode", {(mode, "_look_along"): _none}),
    Rung("jumps that a machine knows", "mode", {(mode.NewtonSearch, "mode_candidates"): _jump_along_alone}),
    Rung("jumps combined", "mode", {(mode, "_combine"): _none}, several=True),
    Rung("last steps by differences", "mode", {(mode, "_settle"): _keep_second}),
    # coordinates
    Rung(
        "stretch by errors",
        "reparameterisation",
        {(exploration, "straighten"): _straighten_alone},
        idle=lambda found, _: not found.blocks,
    ),
    Rung(
        "conditional map",
        "conditional",
        {(reparameterisation, "fit_conditional"): _nothing, (exploration, "fit_conditional"): _nothing},
    ),
    Rung(
        "more draws of errors",
        "conditional",
        {(conditional, "LEAST"): 0},
        ((conditional, "sample_scales"),),
        idle=lambda _, args: args[2] == conditional.N_DRAWS,
    ),
    Rung("exact conditional", "conditional", {(reparameterisation.Reparameterisation, "exactly"): _nothing}),
    Rung("wide errors", "exploration", {(exploration, "_propose_conditionally"): _propose_plainly}),
    Rung("moments of several modes", "exploration", {(exploration, "_propose_several"): _nothing}, several=True),
    Rung("loose shear", "loose", {(exploration, "fit_loose_shear"): _nothing}),
    Rung("traced ridges", "ridges", {(exploration, "trace_ridges"): _keep}),
    Rung("skew along ridges", "quantile_transform", {(ridges, "_fit_skew"): _nothing}),
    Rung("bend of errors", "peaks", {(exploration, "bend_at"): _keep_both}),
    # proposal
    Rung("refined peaks", "peaks", {(exploration, "refine_peak"): _keep_second}),
    Rung("rounds of sharpening", "exploration", {(exploration, "MAX_ROUNDS"): 0}, ((exploration, "_sharpen"),)),
    Rung(
        "least weight of a peak",
        "peaks",
        {(peaks, "LEAST_WEIGHT"): 0.0},
        ((exploration, "proposal_from_peaks"),),
        several=True,
    ),
    Rung("adaptation", "adaptation", {(exploration, "adapt_proposal"): _nothing}),
    Rung("pilots", "exploration", {(exploration, "MAX_PILOTS"): 0}, ((exploration, "_refit"),)),
    Rung("clusters", "exploration", {(exploration, "add_clusters"): _keep}),
    Rung("heavier tails", "chain_checks", {(estimate, "widen_tails"): _keep_both}),
    # draws
    Rung("steps until checks pass", "samplers", {(estimate, "_is_enough"): lambda *_: True}),
    Rung("finer density", "exploration", {(exploration, "_look_finer"): lambda *_: NO_DIFFERENCE}),
    Rung("correction", "correction", {(ReadingSubject, "find_costly"): _nothing}, ((estimate, "correct_draws"),)),
    Rung(
        "ensembles in the exact density", "correction", {(estimate, "sample_exactly"): lambda c, f, sample, *_: sample}
    ),
    Rung("refits of left-out rows", "leave_one_out", {(estimate, "refit_doubtful"): _keep}),
    Rung(
        "bridge by modes",
        "bridge",
        {(bridge, "_fit_proposal"): lambda draws, modes: proposal_from_draws(draws, bridge.BRIDGE_DOF)},
        several=True,
    ),
    # checks
    Rung("stands", "diagnostics", {(estimate, "_measure_stand"): lambda *_: 0}, says="stuck walker"),
    Rung(
        "tail mass",
        "chain_checks",
        {(estimate, "compare_tail_mass"): lambda *_: TailShare(0.0, 0.0, 0.0)},
        says="in tails",
    ),
)
