"""Results that are not what a study writes are named: file, place, what was found and what was expected."""

from __future__ import annotations

from dataclasses import replace

import pytest
from made_up_results import PUBLICATION, read_study

from bayescal.errors import InputError
from bayescal.experiments.runner.results import read_results
from bayescal.experiments.study.page.results import StudyResults


@pytest.mark.parametrize(
    ("path", "content", "found"),
    [
        ("summary.json", None, "no such"),
        ("summary.json", "{", "not JSON"),
        ("summary.json", "{}", "expected str"),
        ("provenance.json", None, "no such"),
        ("tables/pose_errors.csv", None, "no such"),
        ("tables/least_squares.csv", "variant,parameter\n", "found columns"),
        ("tables/deformation.csv", None, "no such"),
        ("tables/sensitivity.csv", None, "no such"),
        ("posterior/pus-none.nc", "no hdf5", "not a posterior"),
    ],
)
def test_a_file_at_fault_is_named(make_results, path, content, found):
    folder = make_results()
    if content is None:
        (folder / path).unlink()
    else:
        (folder / path).write_text(content)
    with pytest.raises(InputError, match=found) as caught:
        read_study(folder)
    assert str(folder / path) in str(caught.value)


def test_a_number_missing_from_a_fit_is_named(make_results):
    def change(summary):
        del summary["variants"]["pus/none"]["rhat_max"]

    with pytest.raises(InputError, match=r"variants\.pus/none\.rhat_max: found nothing"):
        read_study(make_results(change))


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("publication", "a book", "publication: found str, expected dict"),
        ("publication", {**PUBLICATION, "citation": None}, r"publication\.citation: found nothing, expected str"),
        ("publication", {**PUBLICATION, "figures": {"errors": 15}}, r"publication\.figures\.errors: found int"),
    ],
)
def test_what_a_study_may_leave_out_is_checked_where_it_is_there(make_results, key, value, found):
    with pytest.raises(InputError, match=rf"summary\.json: {found}"):
        read_study(make_results(lambda summary: summary.update({key: value})))


@pytest.mark.parametrize("name", ["pose_errors", "deformation", "claims"])
def test_a_missing_column_is_named(make_results, name):
    results = read_results(make_results(claims=True))
    column = results.table(name).columns[-1]
    tables = {**results.tables, name: results.table(name).drop(columns=column)}
    if name == "pose_errors":
        tables[name] = results.table(name).drop(columns=(column := "use"))
    with pytest.raises(InputError, match=rf"tables/{name}\.csv: .*'{column}'"):
        StudyResults.of(replace(results, tables=tables))


@pytest.mark.parametrize("name", ["parameters", "poses"])
def test_a_missing_table_is_named(make_results, name):
    results = read_results(make_results())
    tables = {other: table for other, table in results.tables.items() if other != name}
    with pytest.raises(InputError, match=rf"tables/{name}\.csv: .*no rows"):
        StudyResults.of(replace(results, tables=tables))


def test_results_that_stand_nowhere_name_the_file_alone(make_results):
    results = replace(read_results(make_results()), folder=None, summary={})
    with pytest.raises(InputError, match=r"^summary\.json: experiment:"):
        StudyResults.of(results)
