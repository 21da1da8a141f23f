"""What the page says of the model error: what to do, how large it is, where, along what, and what may hide."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from made_up_results import TWO, edit_config, read_study

from bayescal.errors import InputError
from bayescal.experiments.study.page.model_error import KINDS, LEAD, UNDECIDED, show_model_error, state_terms
from bayescal.experiments.study.page.parameters import show_parameters
from bayescal.experiments.study.page.verdict import state_verdict
from bayescal.report.blocks import Figure, Fold, Statement, Table

SEEN, UNSEEN = (12.0, 8.0, 17.0), (1.2, 0.1, 4.0)  # median and 90 % interval, µm: with a trace in the data, without
CHANNELS = {"rho[1]": 2.0, "rho[2]": 9.0, "rho[3]": 2.5}
FUNCTIONS = ("linear", "positioning", "smooth", "drift", "systematic_total")


def tabulate(sizes, members=CHANNELS, variants=TWO):
    """Return the three tables of variants that err alike: sizes by term, rms of each member's error by its name."""
    uses = [*["calibration"] * 4, *["verification"] * 2]
    size = pd.DataFrame([(name, term, *one) for name in variants for term, one in sizes.items()])
    by_member = [(name, one, "positioning", 0.5 * rms) for name in variants for one, rms in members.items()]
    by_pose = [
        (name, f"P{k}", use, member, mean := rms * (-1.0) ** k, mean - 1.0, mean + 1.0)
        for name in variants
        for k, use in enumerate(uses)
        for member, rms in members.items()
    ]
    return {
        "model_error": size.set_axis(["variant", "term", "median", "q05", "q95"], axis=1).assign(unit="um"),
        "model_error_members": pd.DataFrame(by_member, columns=["variant", "member", "term", "rms"]).assign(unit="um"),
        "model_error_poses": pd.DataFrame(
            by_pose, columns=["variant", "pose", "use", "member", "mean", "low", "high"]
        ).assign(unit="um"),
    }


def all_unseen(**seen):
    return dict.fromkeys(("random", *FUNCTIONS), UNSEEN) | seen


def read(make_results, sizes, members=CHANNELS, change=None, **more):
    return read_study(make_results(change, more=tabulate(sizes, members), draws=False, **more))


# --- what is found ---------------------------------------------------------------------------------------------------


def find(study):
    """Return the findings of systematic and of random errors; None of random ones without a term."""
    found = state_terms(study)
    assert all(one.lead == LEAD for one in found)
    return found[0], (found[1] if len(found) > 1 else None)


def test_a_systematic_error_has_its_size_and_an_action(make_results):
    study = read(make_results, all_unseen(positioning=SEEN, systematic_total=(13.0, 9.0, 18.0)))
    systematic, random = find(study)
    assert (systematic.value, systematic.unit) == (13.0, "µm")
    assert "rho[2]" in systematic.action
    assert (random.level, random.value) == ("good", UNSEEN[2])
    assert [one for one in state_verdict(study) if one.lead == LEAD] == [systematic, random]


@pytest.mark.parametrize(
    ("sizes", "members", "level", "value", "kind"),
    [
        (all_unseen(), CHANNELS, "good", 4.0, ""),
        (all_unseen(linear=SEEN, systematic_total=SEEN), CHANNELS, "plain", 12.0, "linear"),
        (all_unseen(drift=SEEN, systematic_total=SEEN), CHANNELS, "plain", 12.0, "drift"),
        (  # two that imitate each other: neither is seen, their sum is
            all_unseen(linear=(5.0, 0.5, 12.0), positioning=(6.0, 0.6, 12.0), systematic_total=(12.0, 9.0, 17.0)),
            CHANNELS,
            "plain",
            12.0,
            "positioning",
        ),
        # of four without any trace of them the sum is no nearer to zero
        (all_unseen(systematic_total=(4.0, 2.2, 8.0)), CHANNELS, "good", 8.0, ""),
        (
            all_unseen(positioning=SEEN, systematic_total=SEEN),
            {"s[1]": 4.0, "s[2]": 5.0},
            "plain",
            12.0,
            "positioning",
        ),
        ({"positioning": SEEN}, {"s": 4.0}, "plain", 12.0, "positioning"),
    ],
)
def test_the_advice_follows_the_largest_term_that_is_seen(make_results, sizes, members, level, value, kind):
    systematic, _ = find(read(make_results, sizes, members))
    assert (systematic.level, systematic.value) == (level, value)
    assert bool(systematic.action) == bool(kind)
    assert not kind or KINDS[kind].along in systematic.text


def test_a_random_error_is_a_finding_of_its_own(make_results):
    systematic, random = find(read(make_results, all_unseen(random=SEEN)))
    assert not systematic.action
    assert (random.level, random.value) == ("plain", 12.0)
    assert random.action


ALONE = {"none": -60.0, "linear": -4.0, "positioning": 5.5, "smooth": -17.0, "drift": -68.0}


def tabulate_alone(alone):
    """Return the table of single causes, which have sizes of 14 [9, 21] µm by themselves."""
    rows = [("pus/linear", term, value, 14.0, 9.0, 21.0) for term, value in alone.items()]
    return pd.DataFrame(rows, columns=["variant", "term", "log_bayes_factor", "median", "q05", "q95"]).assign(unit="um")


@pytest.mark.parametrize(
    ("alone", "causes"),
    [
        (ALONE, ["positioning"]),
        (ALONE | {"linear": 4.0}, ["positioning", "linear"]),
        (ALONE | {"positioning": -9.0}, ["positioning"]),
        (ALONE | {"positioning": 1.0, "none": 3.0}, ["positioning"]),
        (ALONE | {"joints": 80.0, "gravity": -60.0}, ["joints"]),
        (ALONE | {"joints": -60.0, "gravity": 5.0}, ["positioning", "gravity"]),
    ],
)
def test_one_cause_is_named_where_it_is_better_than_any_other(make_results, alone, causes):
    more = tabulate(all_unseen(positioning=SEEN, linear=(4.0, 0.4, 8.0), systematic_total=SEEN), CHANNELS)
    more["model_error_alone"] = tabulate_alone(alone)
    study = read_study(make_results(None, more=more, draws=False))
    statement, _ = find(study)
    assert all(KINDS[cause].along in statement.text for cause in causes)
    assert (statement.action == f"{UNDECIDED}.") == (len(causes) > 1)
    table = next(block for block in show_model_error(study).blocks if isinstance(block, Table))
    shown = {row[0].text: row[2].text for row in table.rows}
    assert shown[KINDS["drift"].along] == "−68.0"
    assert shown["none"].startswith("−60" if alone["none"] < 0.0 else "+3")
    assert (f"{KINDS['gravity'].along}, by itself" in shown) == ("gravity" in alone)


@pytest.mark.parametrize("tail", [1.2, 2.3])
def test_a_size_that_data_hardly_determine_is_a_finding(make_results, tail):
    tables = tabulate(all_unseen(positioning=SEEN))
    tables["model_error"]["tail"] = np.where(tables["model_error"]["term"] == "positioning", tail, 1.0)
    found = state_terms(read_study(make_results(more=tables, draws=False)))
    assert len(found) == 2 + (tail > 2.0)


def test_a_cause_that_has_no_term_is_said_where_all_terms_together_are_not_seen(make_results):
    more = tabulate(all_unseen(), CHANNELS)
    more["model_error_alone"] = tabulate_alone({"none": 6.0, "linear": 4.0, "gravity": 19.0})
    study = read_study(make_results(None, more=more, draws=False))
    statement, _ = find(study)
    assert statement.value == 14.0  # its own size
    assert KINDS["gravity"].along in statement.text


def test_each_term_has_its_size_and_whether_the_data_show_it(make_results):
    section = show_model_error(read(make_results, all_unseen(positioning=SEEN)))
    table = next(block for block in section.blocks if isinstance(block, Table))
    rows = {row[0].text: [cell.text for cell in row[1:3]] for row in table.rows}
    assert rows[KINDS["positioning"].along] == ["12 [8, 17]", "seen"]
    assert rows[KINDS["drift"].along] == ["1.2 [0.1, 4.0]", "no trace"]
    assert len(rows) == len(all_unseen())


def test_members_are_drawn_pose_by_pose_and_counted_over_the_calibration_poses(make_results):
    members = {f"s[{k}]": float(k) for k in range(1, 15)}
    tables = tabulate(all_unseen(positioning=SEEN, systematic_total=SEEN), members)
    poses = tables["model_error_poses"]
    poses.loc[poses["use"] == "verification", "mean"] = 1000.0  # no rms counts it
    section = show_model_error(read_study(make_results(more=tables, draws=False)))
    (figure,) = (block for block in section.blocks if isinstance(block, Figure) and block.name == "model_error")
    assert "The 12 largest." in figure.caption
    drawn = figure.draw()
    assert [axes.get_title() for axes in drawn.axes] == [f"s[{k}]" for k in range(3, 15)]
    full, held = (line.get_ydata() for line in drawn.axes[0].lines[:2])
    assert np.allclose(full, [3.0, -3.0, 3.0, -3.0])
    assert np.allclose(held, 1000.0)
    own = next(block for block in section.blocks if isinstance(block, Table) and block.caption.startswith("By channel"))
    assert [cell.text for cell in own.rows[9]] == ["s[10]", "5.0", "10"]


def test_the_best_variant_stands_in_full_the_others_folded(make_results):
    section = show_model_error(read(make_results, all_unseen(positioning=SEEN)))
    assert [block.name for block in section.blocks if isinstance(block, Figure)] == ["model_error", "tau"]
    *_, fold = (block for block in section.blocks if isinstance(block, Fold))
    (table,) = fold.blocks
    assert [row[0].text for row in table.rows] == ["pus/linear", "pus/none"]


# --- what may hide ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("floor", "sizes"), [(0.0, []), (10.0, ["10 µm"]), ({"positioning": 5.0, "linear": 0.0}, ["5 µm"])]
)
def test_the_floor_is_stated_where_there_is_one(make_results, floor, sizes):
    folder = make_results(more=tabulate(all_unseen()), draws=False)
    edit_config(folder, lambda config: config["model_error"].update(floor_um=floor))
    section = show_model_error(read_study(folder))
    said = [one.text for one in section.blocks if isinstance(one, Statement) and "floor_um" in one.text]
    assert len(said) == len(sizes)
    assert all(size in one for size, one in zip(sizes, said, strict=True))


def test_a_single_term_that_is_no_larger_than_stated_is_no_finding(make_results):
    folder = make_results(more=tabulate({"positioning": (39.0, 23.0, 60.0)}), draws=False)
    edit_config(folder, lambda config: config["model_error"].update(floor_um={"positioning": 50.0}))
    statement, _ = find(read_study(folder))
    assert (statement.level, statement.action) == ("good", "")


def test_what_is_stated_is_no_finding_and_what_is_beyond_it_is(make_results):
    for k, (together, seen) in enumerate({(39.0, 23.0, 60.0): False, (160.0, 120.0, 200.0): True}.items()):
        sizes = all_unseen(smooth=together, systematic_total=together)
        folder = make_results(more=tabulate(sizes), draws=False, name=f"floor{k}")
        edit_config(folder, lambda config: config["model_error"].update(floor_um=50.0))
        statement, _ = find(read_study(folder))
        assert (statement.value == 160.0) == seen
        assert (statement.level == "good") != seen


# --- which section there is, and other sentences ---------------------------------------------------------------------


def test_tau_of_each_leg_is_shown_where_it_has_its_own(make_results):
    study = read(make_results, {"random": SEEN}, {})
    blocks = show_model_error(study).blocks
    (figure,) = (block for block in blocks if isinstance(block, Figure))
    assert figure.name == "tau"
    assert [line.get_ydata().tolist() for line in figure.draw().axes[0].lines[:1]] == [[4.0, 4.0]]
    (table,) = next(block for block in blocks if isinstance(block, Fold) and block.title.startswith("τ ")).blocks
    assert [cell.text for cell in table.rows[0]] == ["pus/linear", "4.0 [2.4, 5.6]", "4.0 [2.4, 5.6]"]


def test_one_tau_of_all_legs_is_in_the_table_of_sizes_alone(make_results):
    edits = {"parameters": lambda table: table[~table["parameter"].str.startswith("tau")]}
    blocks = show_model_error(read(make_results, {"random": SEEN}, {}, edits=edits)).blocks
    assert not any(isinstance(block, Figure) for block in blocks)


@pytest.mark.parametrize("n_taus", [1, 2, 6, 12])
def test_of_several_taus_the_rms_is_not_seen_where_the_data_say_nothing(make_results, n_taus):
    """The rms of many draws from half-normal priors is never near zero, though nothing is seen of any."""
    draws = np.abs(np.random.default_rng(1).normal(size=(20_000, n_taus)))
    size = np.quantile(np.sqrt(np.mean(draws**2, axis=1)), [0.5, 0.05, 0.95])

    def give(table):
        others = table[~table["parameter"].str.startswith("tau")]
        one = table[table["parameter"] == "tau[1]"]
        return pd.concat([others, *(one.assign(parameter=f"tau[{k}]") for k in range(1, n_taus + 1))])

    _, random = find(read(make_results, {"random": tuple(size)}, edits={"parameters": give}))
    assert random.level == "good"


def test_without_terms_there_is_no_section(make_results):
    assert show_model_error(read_study(make_results(edits={"model_error": lambda table: table.iloc[:0]}))) is None


@pytest.mark.parametrize(("unit", "shown", "heading"), [("mm", "4.0", "µm"), ("noise", "0.0040", "× noise")])
def test_tau_of_each_channel_is_in_the_unit_of_its_parameter(make_results, unit, shown, heading):
    def change(table):
        return table.assign(unit=table["unit"].mask(table["parameter"].str.startswith("tau"), unit))

    section = show_model_error(read_study(make_results(edits={"parameters": change})))
    (fold,) = (one for one in section.blocks if isinstance(one, Fold) and "τ" in one.title)
    (table,) = (one for one in fold.blocks if isinstance(one, Table))
    assert table.columns[1].unit == heading
    assert float(table.rows[0][1].text.partition(" ")[0]) == float(shown)


def test_sizes_of_errors_are_no_parameters_of_the_machine(make_results):
    def add(table):
        own = table[table["parameter"] == "tau[1]"].assign(parameter="sigma_positioning", verdict="noise")
        return pd.concat([table, own], ignore_index=True)

    edits, tables = {"parameters": add}, tabulate(all_unseen())
    legs = show_parameters(read_study(make_results(more=tables, draws=False, edits=edits)))
    shown = " ".join(cell.text for block in legs.blocks if isinstance(block, Fold) for cell in _list_cells(block))
    assert "a_x" in shown
    assert "sigma_positioning" not in shown
    shown = {"more": tables, "draws": False, "edits": edits, "published": False, "name": "readings"}
    folder = make_results(lambda summary: summary.pop("models"), **shown)
    (table,) = (one for one in show_parameters(read_study(folder)).blocks if isinstance(one, Table))
    names = [row[0].text for row in table.rows]
    assert "a_x[1]" in names
    assert not {"sigma_positioning", "tau[1]"} & set(names)


def _list_cells(fold):
    return [cell for table in fold.blocks if isinstance(table, Table) for row in table.rows for cell in row]


def test_a_term_that_is_not_known_is_named(make_results):
    folder = make_results(more=tabulate({"wobble": SEEN}), draws=False)
    with pytest.raises(InputError, match=r"model_error\.csv, line 2: term: .*'wobble'.* random"):
        read_study(folder)


@pytest.mark.parametrize(("none", "seen"), [(-7.0, True), (-2.0, False)])
def test_evidence_against_no_error_shows_one_whatever_the_sizes(make_results, none, seen):
    more = tabulate(all_unseen(), CHANNELS)
    more["model_error_alone"] = tabulate_alone({"none": none, "linear": -1.0, "smooth": -1.5})
    statement, _ = find(read_study(make_results(None, more=more, draws=False)))
    assert bool(statement.action) == seen
