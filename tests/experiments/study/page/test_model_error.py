"""What the page says of the model error: what to do, how large it is, where, along what, and what may hide."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from made_up_results import TWO, edit_config, read_study

from bayescal.errors import InputError
from bayescal.experiments.study.page.model_error import show_model_error, state_terms
from bayescal.experiments.study.page.parameters import show_parameters
from bayescal.experiments.study.page.verdict import state_verdict
from bayescal.report.blocks import Figure, Fold, Statement, Table

SEEN, UNSEEN = (12.0, 8.0, 17.0), (1.2, 0.1, 4.0)  # median and 90 % interval, µm: with a trace in the data, without
CHANNELS = {"rho[1]": 2.0, "rho[2]": 9.0, "rho[3]": 2.5}
FUNCTIONS = ("linear", "own", "smooth", "drift", "together")


def tabulate(sizes, members=CHANNELS, variants=TWO):
    """Return the three tables of variants that err alike: sizes by term, rms of each member's error by its name."""
    uses = [*["calibration"] * 4, *["verification"] * 2]
    size = pd.DataFrame([(name, term, *one) for name in variants for term, one in sizes.items()])
    by_member = [(name, one, "own", 0.5 * rms) for name in variants for one, rms in members.items()]
    by_pose = [
        (name, f"P{k}", use, member, mean := rms * (-1.0) ** k, mean - 1.0, mean + 1.0)
        for name in variants
        for k, use in enumerate(uses)
        for member, rms in members.items()
    ]
    return {
        "model_error": size.set_axis(["variant", "term", "median_um", "q05_um", "q95_um"], axis=1),
        "model_error_members": pd.DataFrame(by_member, columns=["variant", "member", "term", "rms_um"]),
        "model_error_poses": pd.DataFrame(
            by_pose, columns=["variant", "pose", "use", "member", "mean_um", "low_um", "high_um"]
        ),
    }


def all_unseen(**seen):
    return dict.fromkeys(("independent", *FUNCTIONS), UNSEEN) | seen


def read(make_results, sizes, members=CHANNELS, change=None, **more):
    return read_study(make_results(change, more=tabulate(sizes, members), draws=False, **more))


# --- what is found ---------------------------------------------------------------------------------------------------


def test_says_what_to_do_then_how_large_it_is_and_where(make_results):
    study = read(make_results, all_unseen(own=SEEN, together=(13.0, 9.0, 18.0)))
    (statement,) = state_terms(study)
    assert statement.text == (
        "Check lead, scale and eccentricity of the encoder of rho[2], or free them as parameters. pus/linear leaves "
        "out a systematic error of 13 [9, 18] µm rms (90 % interval), most of it in rho[2] (9.0 µm rms, the others "
        "2.0 to 2.5 µm); the largest part is a function of the own position (a lead error, the scale of an encoder, "
        "an encoder or a screw that is eccentric). The "
        "intervals allow for it. No random error from pose to pose is seen beyond the noise (τ: 95 % upper "
        "limit 4.0 µm)."
    )
    assert [one.text for one in state_verdict(study) if one.lead == "Model error"] == [statement.text]
    assert show_model_error(study).blocks[0] == statement


@pytest.mark.parametrize(
    ("sizes", "members", "level", "said"),
    [
        (all_unseen(), CHANNELS, "good", "no systematic error is seen (95 % upper limit 4.0 µm rms over all channels)"),
        (all_unseen(independent=SEEN), CHANNELS, "plain", "Measure one pose several times … τ = 12 [8, 17] µm"),
        (
            all_unseen(linear=SEEN, together=SEEN),
            CHANNELS,
            "plain",
            "Look for a coupling … linear in the positions of all",
        ),
        (all_unseen(drift=SEEN, together=SEEN), CHANNELS, "plain", "Let the machine warm up … temperature"),
        (  # two that imitate each other: neither is seen, their sum is
            all_unseen(linear=(5.0, 0.5, 12.0), own=(6.0, 0.6, 12.0), together=(12.0, 9.0, 17.0)),
            CHANNELS,
            "plain",
            "Check lead, scale and eccentricity of the encoder of rho[2] … 12 [9, 17] µm rms",
        ),
        (  # of four without any trace of them the sum is no nearer to zero
            all_unseen(together=(4.0, 2.2, 8.0)),
            CHANNELS,
            "good",
            "no systematic error is seen (95 % upper limit 8.0 µm rms over all channels)",
        ),
        (
            all_unseen(own=SEEN, together=SEEN),
            {"s[1]": 4.0, "s[2]": 5.0},
            "plain",
            "of every channel, or free … in all channels (4.0 to 5.0 µm rms each)",
        ),
        ({"own": SEEN}, {"s": 4.0}, "plain", "12 [8, 17] µm rms (90 % interval), in s; … allow for it."),
    ],
)
def test_the_advice_follows_the_largest_term_that_is_seen(make_results, sizes, members, level, said):
    (statement,) = state_terms(read(make_results, sizes, members))
    places = [statement.text.find(words) for words in said.split(" … ")]
    assert min(places) >= 0
    assert places == sorted(places)
    assert statement.level == level


ALONE = {"none": -60.0, "linear": -4.0, "own": 5.5, "smooth": -17.0, "drift": -68.0}


def tabulate_alone(alone):
    """Return the table of single causes, which have sizes of 14 [9, 21] µm by themselves."""
    rows = [("pus/linear", term, value, 14.0, 9.0, 21.0) for term, value in alone.items()]
    return pd.DataFrame(rows, columns=["variant", "term", "log_odds", "median_um", "q05_um", "q95_um"])


@pytest.mark.parametrize(
    ("alone", "said"),
    [
        (ALONE, "Check lead … all of it may be a function of the own position … odds of 13,000 to 1 against any other"),
        (
            ALONE | {"linear": 4.0},
            "Measure more poses … it is a function of the own position or linear in the positions of all",
        ),
        (ALONE | {"own": -9.0}, "the largest part is a function of the own position … no single cause explains all"),
        (ALONE | {"own": 1.0, "none": 3.0}, "Check lead … the largest part is a function of the own position"),
        (
            ALONE | {"joints": 80.0, "gravity": -60.0},
            "Look at the joints of … all of it may be quadratic in the pose, in each channel another … against any",
        ),
        (
            ALONE | {"joints": -60.0, "gravity": 5.0},
            "Measure more poses … own position or a function of the pose, alike in all",
        ),
    ],
)
def test_one_cause_is_named_where_it_is_better_than_any_other(make_results, alone, said):
    more = tabulate(all_unseen(own=SEEN, linear=(4.0, 0.4, 8.0), together=SEEN), CHANNELS)
    more["model_error_alone"] = tabulate_alone(alone)
    study = read_study(make_results(None, more=more, draws=False))
    (statement,) = state_terms(study)
    places = [statement.text.find(words) for words in said.split(" … ")]
    assert min(places) >= 0, statement.text
    table = next(block for block in show_model_error(study).blocks if isinstance(block, Table))
    shown = {row[0].text: row[2].text for row in table.rows}
    assert shown["with time, in measuring order"] == "−68.0"
    assert shown["no systematic error"].startswith("−60" if alone["none"] < 0.0 else "+3")
    assert ("a function of the pose, alike in all channels, by itself" in shown) == ("gravity" in alone)


@pytest.mark.parametrize("tail", [1.2, 2.3])
def test_a_size_that_data_hardly_determine_is_said_to_count_by_its_interval(make_results, tail):
    tables = tabulate(all_unseen(own=SEEN))
    tables["model_error"]["tail"] = np.where(tables["model_error"]["term"] == "own", tail, 1.0)
    found = state_terms(read_study(make_results(more=tables, draws=False)))
    assert any("2.3 times" in one.text for one in found) == (tail > 2.0)


def test_a_cause_that_has_no_term_is_said_where_all_terms_together_are_not_seen(make_results):
    more = tabulate(all_unseen(), CHANNELS)
    more["model_error_alone"] = tabulate_alone({"none": 6.0, "linear": 4.0, "gravity": 19.0})
    study = read_study(make_results(None, more=more, draws=False))
    (statement,) = state_terms(study)
    assert statement.text.startswith("Measure with another load")
    assert "a systematic error of 14 [9, 21] µm rms (90 % interval); all" in statement.text  # its own size
    assert "all of it may be a function of the pose, alike in all channels" in statement.text


def test_each_term_has_its_size_and_whether_the_data_show_it(make_results):
    section = show_model_error(read(make_results, all_unseen(own=SEEN)))
    table = next(block for block in section.blocks if isinstance(block, Table))
    rows = {row[0].text: [cell.text for cell in row[1:3]] for row in table.rows}
    assert rows["a function of the own position"] == ["12 [8, 17]", "seen"]
    assert rows["with time, in measuring order"] == ["1.2 [0.1, 4.0]", "no trace"]
    assert len(rows) == len(all_unseen())


def test_members_are_drawn_pose_by_pose_and_counted_over_the_calibration_poses(make_results):
    members = {f"s[{k}]": float(k) for k in range(1, 15)}
    tables = tabulate(all_unseen(own=SEEN, together=SEEN), members)
    poses = tables["model_error_poses"]
    poses.loc[poses["use"] == "verification", "mean_um"] = 1000.0  # no rms counts it
    section = show_model_error(read_study(make_results(more=tables, draws=False)))
    (figure,) = (block for block in section.blocks if isinstance(block, Figure) and block.name == "model_error")
    assert "Shown are the 12 that err most" in figure.caption
    drawn = figure.draw()
    assert [axes.get_title() for axes in drawn.axes] == [f"s[{k}]" for k in range(3, 15)]
    full, held = (line.get_ydata() for line in drawn.axes[0].lines[:2])
    assert np.allclose(full, [3.0, -3.0, 3.0, -3.0])
    assert np.allclose(held, 1000.0)
    own = next(block for block in section.blocks if isinstance(block, Table) and "which channel" in block.caption)
    assert [cell.text for cell in own.rows[9]] == ["s[10]", "5.0", "10"]


def test_the_best_variant_stands_in_full_the_others_folded(make_results):
    section = show_model_error(read(make_results, all_unseen(own=SEEN)))
    assert [block.name for block in section.blocks if isinstance(block, Figure)] == ["model_error", "tau"]
    *_, fold = (block for block in section.blocks if isinstance(block, Fold))
    (table,) = fold.blocks
    assert [row[0].text for row in table.rows] == ["pus/linear", "pus/none"]


# --- what may hide ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("floor", "said"),
    [
        (0.0, "None is allowed for beyond what the terms above suggest: if one of some size cannot be excluded, state"),
        (10.0, "as stated (at_least_um), 10 µm rms are allowed for even where none is seen"),
        ({"own": 5.0, "linear": 0.0}, "5 µm rms a function of the own position are allowed for"),
    ],
)
def test_says_what_is_allowed_for_of_errors_without_a_trace(make_results, floor, said):
    folder = make_results(more=tabulate(all_unseen()), draws=False)
    edit_config(folder, lambda config: config["model_error"].update(at_least_um=floor))
    section = show_model_error(read_study(folder))
    (text,) = (one.text for one in section.blocks if isinstance(one, Statement) and "leaves no trace" in one.text)
    assert said in text


def test_a_single_term_that_is_no_larger_than_stated_is_no_finding(make_results):
    folder = make_results(more=tabulate({"own": (39.0, 23.0, 60.0)}), draws=False)
    edit_config(folder, lambda config: config["model_error"].update(at_least_um={"own": 50.0}))
    (statement,) = state_terms(read_study(folder))
    assert "no systematic error beyond the 50 µm rms that are stated is seen" in statement.text


def test_what_is_stated_is_no_finding_and_what_is_beyond_it_is(make_results):
    for k, (together, seen) in enumerate({(39.0, 23.0, 60.0): False, (160.0, 120.0, 200.0): True}.items()):
        sizes = all_unseen(smooth=together, together=together)
        folder = make_results(more=tabulate(sizes), draws=False, name=f"floor{k}")
        edit_config(folder, lambda config: config["model_error"].update(at_least_um=50.0))
        (statement,) = state_terms(read_study(folder))
        assert ("leaves out a systematic error of 160 [120, 200] µm rms" in statement.text) == seen
        stated = "no systematic error beyond the 50 µm rms that are stated is seen; the intervals allow for these."
        assert (stated in statement.text) != seen


# --- which section there is, and other sentences ---------------------------------------------------------------------


def test_tau_of_each_leg_is_shown_where_it_has_its_own(make_results):
    study = read(make_results, {"independent": SEEN}, {})
    (statement,) = state_terms(study)
    assert "has no term for systematic errors: its intervals do not allow for them" in statement.text
    blocks = show_model_error(study).blocks
    assert blocks[0] == statement
    (figure,) = (block for block in blocks if isinstance(block, Figure))
    assert figure.name == "tau"
    assert [line.get_ydata().tolist() for line in figure.draw().axes[0].lines[:1]] == [[4.0, 4.0]]
    (table,) = next(block for block in blocks if isinstance(block, Fold) and "τ of every leg" in block.title).blocks
    assert [cell.text for cell in table.rows[0]] == ["pus/linear", "4.0 [2.4, 5.6]", "4.0 [2.4, 5.6]"]


def test_one_tau_of_all_legs_is_in_the_table_of_sizes_alone(make_results):
    edits = {"parameters": lambda table: table[~table["parameter"].str.startswith("tau")]}
    blocks = show_model_error(read(make_results, {"independent": SEEN}, {}, edits=edits)).blocks
    assert not any(isinstance(block, Figure) for block in blocks)
    assert any("Measure one pose several times" in getattr(block, "text", "") for block in blocks)


@pytest.mark.parametrize("n_taus", [1, 2, 6, 12])
def test_of_several_taus_the_rms_is_not_seen_where_the_data_say_nothing(make_results, n_taus):
    """The rms of many draws from half-normal priors is never near zero, though nothing is seen of any."""
    draws = np.abs(np.random.default_rng(1).normal(size=(20_000, n_taus)))
    size = np.quantile(np.sqrt(np.mean(draws**2, axis=1)), [0.5, 0.05, 0.95])

    def give(table):
        others = table[~table["parameter"].str.startswith("tau")]
        one = table[table["parameter"] == "tau[1]"]
        return pd.concat([others, *(one.assign(parameter=f"tau[{k}]") for k in range(1, n_taus + 1))])

    (statement,) = state_terms(read(make_results, {"independent": tuple(size)}, edits={"parameters": give}))
    assert "No random error from pose to pose is seen" in statement.text


def test_without_terms_there_is_no_section(make_results):
    assert show_model_error(read_study(make_results(edits={"model_error": lambda table: table.iloc[:0]}))) is None


def test_sizes_of_errors_are_no_parameters_of_the_machine(make_results):
    def add(table):
        own = table[table["parameter"] == "tau[1]"].assign(parameter="sigma_own", verdict="noise")
        return pd.concat([table, own], ignore_index=True)

    edits, tables = {"parameters": add}, tabulate(all_unseen())
    legs = show_parameters(read_study(make_results(more=tables, draws=False, edits=edits)))
    shown = " ".join(cell.text for block in legs.blocks if isinstance(block, Fold) for cell in _list_cells(block))
    assert "a_x" in shown
    assert "sigma_own" not in shown
    shown = {"more": tables, "draws": False, "edits": edits, "published": False, "name": "readings"}
    folder = make_results(lambda summary: summary.pop("models"), **shown)
    (table,) = (one for one in show_parameters(read_study(folder)).blocks if isinstance(one, Table))
    names = [row[0].text for row in table.rows]
    assert "a_x[1]" in names
    assert not {"sigma_own", "tau[1]"} & set(names)


def _list_cells(fold):
    return [cell for table in fold.blocks if isinstance(table, Table) for row in table.rows for cell in row]


def test_a_term_that_is_not_known_is_named(make_results):
    folder = make_results(more=tabulate({"wobble": SEEN}), draws=False)
    with pytest.raises(InputError, match=r"model_error\.csv: variant pus/none: term: found 'wobble', expected one of"):
        read_study(folder)


@pytest.mark.parametrize(("none", "seen"), [(-7.0, True), (-2.0, False)])
def test_evidence_against_no_error_shows_one_whatever_the_sizes(make_results, none, seen):
    more = tabulate(all_unseen(), CHANNELS)
    more["model_error_alone"] = tabulate_alone({"none": none, "linear": -1.0, "smooth": -1.5})
    (statement,) = state_terms(read_study(make_results(None, more=more, draws=False)))
    assert ("leaves out" in statement.text) == seen
    assert ("no systematic error is seen" in statement.text) != seen
