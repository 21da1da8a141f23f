"""The page of a study on disk: self-contained, escaped, the same bytes from the same results."""

from __future__ import annotations

import re

import pytest
from html_reader import Reader
from made_up_results import PUBLICATION, TWELVE, edit_config, render_text, set_fit, write_report

from bayescal.errors import InputError

pytestmark = pytest.mark.runs


def test_page_is_self_contained_well_formed_and_has_the_same_bytes_again(make_results, pictures):
    page, other = (write_report(make_results(name=name)) for name in ("one", "other"))
    images, others = (sorted((one.parent / "figures").iterdir()) for one in (page, other))
    assert page.read_bytes() == other.read_bytes()
    assert [p.read_bytes() for p in images] == [p.read_bytes() for p in others]
    assert not any(b"Software" in p.read_bytes() or b"tEXtDate" in p.read_bytes() for p in images)
    text = page.read_text(encoding="utf-8")
    reader = Reader(text)
    assert reader.open == []
    assert reader.pictures == 13
    assert all(r.startswith(("data:image/png;base64,", "#")) for r in reader.references)
    assert reader.tags.count("script") == 1
    assert not {"link", "iframe", "object"} & set(reader.tags)
    assert not re.search(r"url\((?!#)|@import", text)
    assert {r[1:] for r in reader.references if r.startswith("#")} <= set(re.findall(r'id="([^"]+)"', text))
    assert {p.name for p in page.parent.iterdir()} == {
        "summary.json",
        "provenance.json",
        "tables",
        "posterior",
        "figures",
        "report.html",
    }


def test_text_from_the_results_is_escaped(make_results, pictures):
    attack = "<script>alert('x')</script> & \"$_^{ $\" <b>"

    def change(summary):
        summary["title"] = summary["origin"]["text"] = summary["experiment"] = attack
        summary["pose_extraction"]["rejected_targets"] = [f"{attack}/P1"]
        summary["variants"]["pus/none"]["problems"] = attack
        summary["variants"]["pus/none"]["title"] = "<b>$x_$</b>"

    folder = make_results(change)
    for name, old, new in (("pose_errors", ",C0,", ",<script>$C0,"), ("parameters", ",l[", ",<i>$x_$[")):
        table = folder / "tables" / f"{name}.csv"
        table.write_text(table.read_text().replace(old, new))
    text = write_report(folder).read_text(encoding="utf-8")
    reader = Reader(text)
    assert reader.tags.count("script") == 1
    assert "b" not in reader.tags
    assert "&lt;script&gt;alert(&#39;x&#39;)" in text
    assert "&lt;i&gt;$x_$" in text


def test_without_draws_and_ring_the_report_says_what_is_left_out(make_results, no_pictures):
    folder = make_results(draws=False, ring=False)
    (folder / "figures").mkdir()
    (folder / "figures" / "ridges.png").write_bytes(b"of an earlier report")
    text = write_report(folder).read_text(encoding="utf-8")
    assert any("pus/linear" in reason for reason in re.findall(r"Figure left out: ([^<]*)\.<", text))
    assert not (folder / "figures" / "ridges.png").exists()
    assert (folder / "figures" / "parameters.png").is_file()


def test_without_verification_poses_the_figures_are_drawn(make_results, pictures):
    folder = make_results(verification=False)
    text = write_report(folder).read_text(encoding="utf-8")
    assert Reader(text).pictures == 13
    assert '<td class="text plain">none</td>' in text


def test_data_origin_and_failures_stand_before_the_headline(make_results):
    change = set_fit("pus/linear", converged=False, problems="bulk ESS 12, limit 1000")
    text = render_text(make_results(change))
    places = [text.index(s) for s in ("made up for a test", "bulk ESS 12", 'class="headline"', 'id="ranking"')]
    assert places == sorted(places)
    assert 'class="verdict bad"' in text


def test_nothing_is_written_where_the_results_are_at_fault(make_results):
    folder = make_results()
    (folder / "summary.json").unlink()
    before = sorted(folder.rglob("*"))
    with pytest.raises(InputError, match=r"summary\.json"):
        write_report(folder)
    assert sorted(folder.rglob("*")) == before


def test_twelve_variants_make_one_page_with_long_tables_folded(make_results, no_pictures):
    folder = make_results(variants=TWELVE, claims=True, flexure=True)
    text = write_report(folder).read_text(encoding="utf-8")
    reader = Reader(text)
    assert reader.open == []
    assert reader.pictures == 16
    assert {r[1:] for r in reader.references if r.startswith("#")} <= set(re.findall(r'id="([^"]+)"', text))
    folds = re.findall(r"<details( open)?>\s*<summary>(.*?)</summary>", text)
    assert not any(is_open for is_open, _ in folds)
    assert sum("beside" in title or title.startswith("Table ") for _, title in folds) == 12
    places = [
        text.index(f'id="{name}"') for name in ("verdict", "ranking", "claims", "errors", "parameters", "flexure")
    ]
    assert places == sorted(places)


def test_a_single_variant_is_reported(make_results):
    text = write_report(make_results(variants={"six_pus/linear": (10.0, 1.0)})).read_text(encoding="utf-8")
    assert Reader(text).pictures == 12
    assert "linear deformation" in text.replace("\u00a0", " ")


@pytest.mark.parametrize("drive", ["base", "strut"])
def test_a_study_of_anybodys_machine_has_no_word_of_a_publication(make_results, drive):
    folder = make_results(variants=TWELVE, published=False, flexure=True, drive=drive)
    text = render_text(folder)
    assert "<h2>Parameters</h2>" in text
    assert not re.findall(r"RR-8096|Yu\b|[Pp]ubli|\breport figure|\beqs?\. |\(after ", text)
    images = {image for image in re.findall(r"<figcaption>([^<]*)", text) if "Joints from above" in image}
    assert len(images) == 1  # the captions were among what was searched
    told = render_text(make_results(variants=TWELVE, flexure=True, publication=PUBLICATION, drive=drive, name="told"))
    for word in ("figure 9", "figure 18", "eq. 1", "published tables", PUBLICATION["citation"]):
        assert word in told.replace("\u00a0", " ")


def test_failed_convergence_opens_the_diagnostics(make_results):
    problems = "bulk ESS 12, limit 1000"
    text = render_text(make_results(set_fit("beam/none", converged=False, problems=problems), variants=TWELVE))
    assert f"beam/none: {problems}" in text
    assert re.search(r"<details open>\s*<summary>Convergence", text)


def test_figures_of_deformations_that_are_gone_are_removed(make_results, no_pictures):
    folder = make_results(variants=TWELVE)
    (folder / "figures").mkdir()
    for name in ("errors_quadratic", "flexure"):
        (folder / "figures" / f"{name}.png").write_bytes(b"of an earlier report")
    write_report(folder)
    names = {path.stem for path in (folder / "figures").iterdir()}
    assert {"errors", "errors_none", "errors_linear", "errors_matrix", "parameters"} <= names
    assert not {"errors_quadratic", "flexure"} & names


def test_the_provenance_shows_the_config(make_results, no_pictures):
    folder = make_results()
    edit_config(folder, lambda config: config.update(b={"c": [{"d": "x [ y ]"}, 0.5]}))
    text = write_report(folder).read_text(encoding="utf-8")
    assert "&#34;x [ y ]&#34;" in text
    assert text.index('id="notation"') < text.index('id="provenance"')
