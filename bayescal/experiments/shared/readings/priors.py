"""Priors of a machine's parameters, by symbol."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from math import isfinite
from typing import Protocol

from bayescal.config.load import suggest
from bayescal.density.priors import NormalPrior, Prior, UniformPrior
from bayescal.density.schema import FixedConfig, PriorConfig
from bayescal.errors import InputError
from bayescal.experiments.shared.readings.schema import FreeConfig
from bayescal.experiments.shared.schema import UnitsConfig
from bayescal.limits import WIDTH_BOUNDS
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.units import Units

type Chosen = tuple[dict[str, Prior], dict[str, float], dict[str, tuple[str, ...]]]


class HasPriors(Protocol):
    """A config that states tolerances."""

    @property
    def parameters(self) -> Mapping[str, PriorConfig]:
        """Tolerance of each symbol."""

    @property
    def units(self) -> UnitsConfig:
        """Their units."""


def choose_priors(
    config: HasPriors, choice: FreeConfig, layout: ParameterLayout, others: Collection[str] = ()
) -> Chosen:
    """Return the priors of the free parameters, the values of fixed ones, and what deviates alike.

    Parameters
    ----------
    choice : FreeConfig
        What of it is free, and what deviates alike.
    layout : ParameterLayout
        Of the machine.
    others : collection of str
        Symbols that other machines have.

    Raises
    ------
    InputError
        For an unknown symbol, a free one without a prior, a list of another length, and a prior's range in which there
        is no machine.
    """
    units = Units(config.units.length, config.units.angle)
    known = {*layout.symbols, *others}
    for symbol in config.parameters:
        if symbol not in layout.symbols and symbol not in others:
            near = suggest(symbol, known)
            raise InputError(f"parameters: found {symbol!r}{near}, expected one of {', '.join(layout.symbols)}")
    free = _choose_free(config.parameters, choice, layout)
    priors: dict[str, Prior] = {}
    fixed: dict[str, float] = {}
    for block in layout.blocks:
        prior = config.parameters.get(block.symbol)
        if prior is None:
            continue
        factor = units.factor(block.unit)
        if prior.prior == "fixed":
            offsets = spread_over_legs(prior.offset, len(block.nominal), block.symbol)
            fixed |= {n: v + factor * o for n, v, o in zip(block.names, block.nominal, offsets, strict=True)}
        else:
            priors |= {name: one for name, one in _priors_of(block, prior, factor).items() if name in free}
    check_ranges(priors, layout)
    common = _list_common(choice.tied, priors, layout)
    return _join(priors, common), fixed, common


def check_optional(model: ReadingModel, free: Iterable[str]) -> None:
    """Raise InputError where optional parameters of channels are free and none of these channels is read."""
    names = list(free)
    for symbol, kind in model.optional.items():
        members = [name for name in model.layout.block(symbol).names if name in names]
        if members and not {f"{kind}{name.removeprefix(symbol)}" for name in members} & {*model.names}:
            raise InputError(f"parameters.{symbol}: found {members[0]} free, expected {kind} among the sensors")


def _choose_free(parameters: Mapping[str, PriorConfig], choice: FreeConfig, layout: ParameterLayout) -> set[str]:
    with_prior, known = set[str](), set[str]()
    for block in layout.blocks:
        widths = _list_widths(block, parameters.get(block.symbol, FixedConfig(prior="fixed")))
        for name, width in zip(block.names, widths, strict=True):
            (with_prior if width > 0.0 else known).add(name)
    free = with_prior if choice.free is None else set()
    for entry in choice.free or ():
        named = set(expand(entry, layout, "free"))
        if entry in layout.symbols:  # the members of which no width is zero
            named -= known if named & with_prior else set()
        if not named <= with_prior:
            raise InputError(f"free: found {entry!r}, expected a prior in [parameters]")
        free |= named
    return free.difference(*(expand(entry, layout, "fixed") for entry in choice.fixed))


def expand(entry: str, layout: ParameterLayout, field: str) -> tuple[str, ...]:
    """Return the parameters of a symbol, or the one of that name."""
    if entry in layout.symbols:
        return layout.block(entry).names
    if entry in layout.names:
        return (entry,)
    raise InputError(f"{field}: found {entry!r}, expected one of {', '.join(layout.symbols)}, or a name")


def spread_over_legs(value: float | list[float], n: int, symbol: str, field: str = "parameters") -> list[float]:
    """Return one value per leg, of one for all or one for each; InputError for a list of another length."""
    values = value if isinstance(value, list) else [value] * n
    if len(values) != n:
        expected = "1" if n == 1 else f"1 or {n}, one per leg"
        raise InputError(f"{field}.{symbol}: found {len(values)} values, expected {expected}")
    return values


def _list_widths(block: ParameterBlock, prior: PriorConfig) -> list[float]:
    """Return the width of each member's prior as stated, zero of those that are known."""
    if prior.prior == "fixed":
        return [0.0] * len(block.nominal)
    given = prior.sd if prior.prior == "normal" else prior.half_width
    return spread_over_legs(given, len(block.nominal), block.symbol)


def _priors_of(block: ParameterBlock, prior: PriorConfig, factor: float) -> dict[str, Prior]:
    """Return the priors of a block's members of which the width is not zero."""
    widths = [factor * width for width in _list_widths(block, prior)]
    smallest, largest = WIDTH_BOUNDS.get(block.unit, (0.0, float("inf")))
    for width in filter(None, widths):
        if not smallest <= width <= largest:
            found = f"found a tolerance of {width:g}{'' if block.unit == '1' else f' {block.unit}'}"
            raise InputError(f"parameters.{block.symbol}: {found}, expected between {smallest:g} and {largest:g}")
    pairs = [one for one in zip(block.names, block.nominal, widths, strict=True) if one[2] > 0.0]
    if prior.prior == "normal":
        return {name: NormalPrior(value, width) for name, value, width in pairs}
    return {name: UniformPrior(value - width, value + width) for name, value, width in pairs}


def widen(prior: Prior, factor: float) -> Prior:
    """Return a normal or uniform prior whose width is multiplied by a factor, its mean the same."""
    if isinstance(prior, NormalPrior):
        return NormalPrior(prior.centre, factor * prior.scale)
    assert isinstance(prior, UniformPrior)
    half = 0.5 * factor * (prior.upper - prior.lower)
    return UniformPrior(prior.mean - half, prior.mean + half)


def check_ranges(
    priors: Mapping[str, Prior], layout: ParameterLayout, common: Mapping[str, tuple[str, ...]] | None = None
) -> None:
    """Raise InputError for a prior whose middle, or the ends of which where it has any, are no machine's parameters."""
    for name, prior in priors.items():
        place = layout.names.index((common or {}).get(name, (name,))[0])
        lower, upper = (float(limit[place]) for limit in layout.limits)
        if not lower < prior.mean < upper:
            found = f"found {prior.mean:g}, expected a value between {lower:g} and {upper:g}"
            raise InputError(f"parameter {name}: {found}")
        low, high = prior.bounds
        if isfinite(low) and (low < lower or high > upper):
            raise InputError(
                f"parameter {name}: found a prior from {low:g} to {high:g}, expected it within {lower:g} to {upper:g}"
            )


def _list_common(
    entries: Sequence[str | list[str]], priors: Mapping[str, Prior], layout: ParameterLayout
) -> dict[str, tuple[str, ...]]:
    """Return what deviates alike by a name of its own, such as ``R[1,2,3]``."""
    common: dict[str, tuple[str, ...]] = {}
    for entry in entries:
        names = [entry] if isinstance(entry, str) else entry
        members = tuple(dict.fromkeys(one for name in names for one in expand(name, layout, "tied")))
        if len(members) < 2:
            raise InputError(f"tied: found {entry!r}, one parameter, expected two")
        for name in members:
            if name not in priors:
                raise InputError(f"tied: found {name!r}, which is fixed, expected free parameters")
        common[_name(members)] = members
    return common


def _name(members: Sequence[str]) -> str:
    symbols = {name.partition("[")[0] for name in members}
    if len(symbols) > 1 or not all("[" in name for name in members):
        return "=".join(members)
    return f"{symbols.pop()}[{','.join(name.partition('[')[2].rstrip(']') for name in members)}]"


def _join(priors: Mapping[str, Prior], common: Mapping[str, tuple[str, ...]]) -> dict[str, Prior]:
    """Return the priors with one instead of those of all that deviate alike: that of their first."""
    owner = {member: name for name, members in common.items() for member in members}
    joined: dict[str, Prior] = {}
    for name, prior in priors.items():
        joined.setdefault(owner.get(name, name), prior)
    return joined
