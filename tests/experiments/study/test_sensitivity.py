"""The evidence with wider and narrower priors: they keep their ratios, and what no machine has is refused."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import studies

from bayescal.density.priors import NormalPrior, UniformPrior
from bayescal.errors import InputError
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.prior_widths import (
    WidthTask,
    begin_widths,
    find_known,
    list_width_tasks,
    tabulate_widths,
    weigh_widths,
)
from bayescal.experiments.study.readings import fit_variant
from bayescal.inference.exploration import explore
from bayescal.inference.importance import ImportanceEvidence

pytestmark = pytest.mark.runs

UNIFORM = 'kappa = { prior = "uniform", half_width = 0.01 }'
NORMAL = 'kappa = { prior = "normal", sd = 0.01 }'
EFFORT = ("draws = 1000\nmax_draws = 1000", "draws = 4000\nmax_draws = 4000")
FACTORS = [0.5, 3.0]
PER_LEG = "sd = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]"


def load(folder: Path, *changes: tuple[str, str]) -> StudyInputs:
    """Return the inputs of a tiny study with some lines changed."""
    path = studies.write_tiny_study(folder)
    for old, new in changes:
        studies.edit(path, old, new)
    return studies.load_study(path)


@pytest.mark.parametrize("factor", [0.3, 1.0, 4.0])
def test_a_factor_multiplies_the_width_of_every_prior_whatever_its_unit(tmp_path, factor):
    inputs = load(tmp_path, (NORMAL, UNIFORM), ("sd = 2.0", PER_LEG))
    variant = inputs.variants["six_pus/matrix"]
    own, scaled = variant.priors, variant.posterior(factor=factor).priors
    assert list(scaled) == list(own)
    for name, prior in own.items():
        other = scaled[name]
        if name.startswith("l"):
            assert isinstance(prior, NormalPrior)
            assert other == NormalPrior(prior.centre, factor * prior.scale)
        else:
            assert isinstance(prior, UniformPrior)
            assert isinstance(other, UniformPrior)
            assert other.mean == pytest.approx(prior.mean, rel=1e-12)
            assert other.sd == pytest.approx(factor * prior.sd, rel=1e-12)
    assert [own[f"l[{leg}]"].sd for leg in range(1, 7)] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


@pytest.fixture(scope="module")
def refit_nothing():
    """Leave no pose out by another run: evidences do not rest on that."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bayescal.inference.leave_one_out.MAX_REFITS", 0)
        yield


@pytest.fixture(scope="module")
def weighed(refit_nothing, tmp_path_factory):
    """Return the evidences of a tiny study with priors as they are, narrower and wider, by factor and variant."""
    factors = [1.0, *FACTORS]
    inputs = load(
        tmp_path_factory.mktemp("own"), ("prior_width_factors = [1.0]", f"prior_width_factors = {factors}"), EFFORT
    )
    free = {name: fit_variant(inputs, name) for name in inputs.variants}
    return tabulate_widths(free, begin_widths(inputs, free, Run())(), factors).set_index(["factor", "variant"])


@pytest.mark.usefixtures("refit_nothing")
@pytest.mark.parametrize("factor", FACTORS)
def test_the_evidence_of_a_factor_is_that_of_a_study_with_such_priors(weighed, tmp_path, factor):
    scaled = (("sd = 2.0", f"sd = {2.0 * factor}"), ("sd = 0.01", f"sd = {0.01 * factor}"))
    other, table = load(tmp_path, *scaled, EFFORT), weighed
    for name in other.variants:
        importance = fit_variant(other, name).importance
        expected = (importance.log_evidence, importance.standard_error)
        found = table.loc[(factor, name)]
        error = np.hypot(found["log_evidence_se"], expected[1])
        assert found["log_evidence"] == pytest.approx(expected[0], abs=4 * error)
        own = table.loc[(1.0, name), "log_evidence"]
        assert abs(own - expected[0]) > 10 * error  # the width matters


def test_a_factor_of_one_is_the_fit_itself(tmp_path):
    inputs = load(tmp_path, ("prior_width_factors = [1.0]", "prior_width_factors = [1.0, 0.5, 1.0000001]"))
    fit = SimpleNamespace(modes=np.zeros((1, 2)), widths={}, importance=ImportanceEvidence(7.0, 0.1, 0.5, 0.1, 1000))
    widths = list_width_tasks(dict.fromkeys(inputs.variants, fit), inputs.config.sensitivity.prior_width_factors)
    assert len(inputs.variants) == 2
    assert len(widths) == len({task.key for task in widths}) == 4
    assert {task.factor for task in widths} == {0.5, 1.0000001}
    assert not any(task.is_hard for task in widths)


@pytest.mark.parametrize(("efficiency", "pareto_k", "is_hard"), [(0.3, 0.6, False), (0.1, 0.6, True), (0.6, 0.8, True)])
def test_widths_of_a_fit_whose_draws_hardly_count_are_hard(tmp_path, efficiency, pareto_k, is_hard):
    inputs = load(tmp_path)
    importance = ImportanceEvidence(7.0, 0.1, efficiency, pareto_k, 1000)
    fit = SimpleNamespace(modes=np.zeros((1, 2)), widths={}, importance=importance)
    widths = list_width_tasks(dict.fromkeys(inputs.variants, fit), [0.5])
    assert [task.is_hard for task in widths] == [is_hard] * 2


@pytest.mark.parametrize(
    ("behind", "error", "is_enough"), [(0.0, 0.03, True), (0.0, 0.2, False), (90.0, 0.2, True), (90.0, 0.4, False)]
)
def test_moved_draws_are_enough_by_what_is_wanted(tmp_path, behind, error, is_enough):
    """Of a variant out of the question a rough error does."""
    first, second = load(tmp_path).variants
    moved = ImportanceEvidence(1.0, error, 0.5, 0.2, 500)
    fits = {
        name: SimpleNamespace(
            modes=np.zeros((1, 2)), widths={0.5: moved}, importance=ImportanceEvidence(own, 0.01, 0.5, 0.1, 1000)
        )
        for name, own in ((first, 7.0), (second, 7.0 - behind))
    }
    known = find_known(fits, [1.0, 0.5])
    assert ((0.5, second) in known) is is_enough
    assert (second in {task.variant for task in list_width_tasks(fits, [1.0, 0.5], known)}) is not is_enough
    assert not find_known(fits, [1.0, 0.7])


@pytest.mark.parametrize(
    ("behind", "is_hard", "explored"),
    [(0.0, False, ["near", "near", "again"]), (60.0, False, ["near", "near"]), (0.0, True, ["near"])],
)
def test_a_doubtful_evidence_is_mended_where_that_may_help_a_variant_in_question(
    tmp_path, monkeypatch, behind, is_hard, explored
):
    inputs = load(tmp_path, ("prior_width_factors = [1.0]", "prior_width_factors = [1.0, 0.5]"))
    variant = inputs.config.variants[0].name
    found = explore(inputs.variants[variant].posterior(factor=0.5).with_pose_guesses(), np.random.SeedSequence(1))
    said: list[str] = []

    def note(word):
        return lambda *_, **__: said.append(word) or found

    monkeypatch.setattr("bayescal.experiments.study.prior_widths.explore_near", note("near"))
    monkeypatch.setattr("bayescal.experiments.study.prior_widths.explore", note("again"))
    unreliable = ImportanceEvidence(1.0, 0.1, 0.01, 0.9, 100)
    monkeypatch.setattr("bayescal.experiments.study.prior_widths.weigh_proposal", lambda *_: unreliable)
    weighed = weigh_widths(inputs, WidthTask(variant, 0.5, np.stack([mode.y for mode in found.modes]), behind, is_hard))
    assert said == explored
    assert weighed.pareto_k == 0.9  # on the page it is marked


def test_a_uniform_prior_made_too_wide_is_refused(tmp_path):
    changes = (
        (
            'model = "six_pus"\ndeformation = "none"\nfree = ["l"]',
            'model = "beam"\ndeformation = "none"\nfree = ["beta"]',
        ),
        (NORMAL, f'{NORMAL}\nbeta = {{ prior = "uniform", half_width = 0.2 }}'),
    )
    load(tmp_path / "fine", *changes)
    with pytest.raises(
        InputError, match=r"^variant 'beam/none': sensitivity\.prior_width_factors 5: parameter beta\[1\]: found a "
    ):
        load(tmp_path / "wide", *changes, ("prior_width_factors = [1.0]", "prior_width_factors = [1.0, 5.0]"))
