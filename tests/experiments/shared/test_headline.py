"""The rules of headlines: what to use, how good it is, and what may not be said."""

import math
import re
from dataclasses import replace

import pytest

from bayescal.experiments.shared.headline import (
    Candidate,
    choose_candidate,
    find_rivals,
    group_candidates,
    order_candidates,
    say_accuracy,
    say_choice,
    say_probability,
    say_requirements,
    state_rivals,
    state_ruled_out,
    write_headline,
)

RIGID = Candidate("rigid", "rigid", 10.0, size=(3,), error=2.0)
SOFT = Candidate("soft", "soft", 10.6, size=(5,), error=1.0)
WRONG = Candidate("wrong", "wrong", -125.9, size=(2,), error=0.5)


def test_equally_good_variants_are_one_group_and_the_simplest_is_used() -> None:
    candidates = [SOFT, RIGID, WRONG]
    assert group_candidates(candidates) == [[RIGID, SOFT], [WRONG]]
    assert choose_candidate(candidates) is RIGID
    assert say_choice(candidates).startswith("Use rigid, ")


def test_where_variants_tie_the_one_with_fewer_unknowns_is_first() -> None:
    assert order_candidates([WRONG, SOFT, RIGID]) == [RIGID, SOFT, WRONG]


def test_what_did_not_converge_is_not_compared_and_is_said_to_be_better_perhaps() -> None:
    failed = Candidate("best", "best", 107.0, converged=False)
    assert group_candidates([failed, RIGID, WRONG]) == [[RIGID], [WRONG]]
    assert order_candidates([failed, WRONG, RIGID]) == [RIGID, WRONG, failed]
    (said,) = state_rivals([failed, RIGID, WRONG])
    assert (said.level, said.value) == ("warning", 1.0)
    assert [one.name for one in find_rivals([replace(failed, log_evidence=math.nan), RIGID])] == ["best"]
    assert not state_rivals([replace(failed, log_evidence=-90.0), RIGID])
    assert not state_rivals([failed])  # nothing is sound
    assert not group_candidates([failed])


def test_an_uncertain_evidence_distinguishes_less() -> None:
    sure, unsure = Candidate("a", "a", 0.0, 0.1), Candidate("b", "b", -2.0, 1.2)
    assert not sure.is_distinguishable(unsure)
    assert sure.is_distinguishable(Candidate("c", "c", -2.0, 0.1))


def test_what_did_not_converge_is_not_used_nor_called_best_silently() -> None:
    failed, worse = Candidate("best", "best", 30.0, converged=False), Candidate("worse", "worse", -9.0, converged=False)
    assert say_choice([worse, RIGID]).startswith("Use rigid (")
    for candidates, best in (([failed, RIGID], "rigid"), ([failed], "best")):
        said = say_choice(candidates)
        assert said.startswith("Use none")
        assert said.endswith(f"{best})")


def test_a_single_variant_is_not_ranked() -> None:
    assert say_choice([RIGID], "the arm", careful=True).startswith("Use the arm, ")


def test_a_variant_that_is_ruled_out_is_not_shown_as_more_accurate_in_silence() -> None:
    (said,) = state_ruled_out([RIGID, SOFT, WRONG])
    assert (said.level, said.value) == ("warning", pytest.approx(-135.9))
    assert not state_ruled_out([RIGID, SOFT])  # of variants that fit equally well the error may decide


@pytest.mark.parametrize(
    ("probability", "decimals", "said"),
    [(0.744, 0, "74 %"), (1.0, 0, "more than 99 %"), (0.99996, 1, "more than 99.9 %"), (1e-5, 1, "less than 0.1 %")],
)
def test_nothing_is_certain(probability: float, decimals: int, said: str) -> None:
    assert say_probability(probability, decimals) == said


def test_requirements_are_met_with_a_probability() -> None:
    assert "P =" not in say_requirements({})
    assert re.fullmatch(r"\w+ fail: P = 74 %", say_requirements({"x": 0.744}))
    several = {"x": 0.99, "y": 0.94, "": 0.93}
    assert re.fullmatch(r"\w+ pass: P = 93 %.* y 94 %", say_requirements(several))
    assert say_requirements({"x": math.nan, "": math.nan}).startswith("requirements fail")


def test_uncertainties_say_their_coverage() -> None:
    assert say_accuracy({"x": "13 µm"}) == "x 13 µm (standard uncertainty, k = 1)"
    assert say_accuracy({"x": "26 µm"}, 0.95) == "x 26 µm (95 % coverage)"


def test_a_headline_is_made_of_sentences() -> None:
    assert write_headline(["use a; x 1 mm.", "", "none"]) == "Use a; x 1 mm. None."
