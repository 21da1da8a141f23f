"""Every kind's page in a real browser: wide and narrow, light and dark, and printed."""

from __future__ import annotations

import pytest
import tiny_experiments
from browser import SCHEMES, SIZES, check_accessible, check_layout, check_print, open_page, start_browser, unfold
from test_kind_contract import MAKE, run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser():
    with start_browser() as started:
        yield started


def check_page(browser, path, tmp_path):
    """Look at a page at every width and in every scheme, folded and unfolded, and in print."""
    for width in SIZES:
        for scheme in SCHEMES:
            with open_page(browser, path, width, scheme) as page:
                check_layout(page)
                unfold(page)
                check_layout(page)
                if width == SIZES[0]:
                    check_accessible(page)
    check_print(browser, path, tmp_path)


@pytest.mark.parametrize("kind", sorted(MAKE))
def test_the_page_of_every_kind(kind, browser, tmp_path, search_little, pictures):
    run(MAKE[kind](tmp_path), tmp_path / "out")
    check_page(browser, tmp_path / "out" / "report.html", tmp_path)


def test_the_certificate_and_a_machine_that_is_shown(browser, tmp_path, search_little, pictures, call):
    run(MAKE["study"](tmp_path), tmp_path / "out")
    path = tmp_path / "certificate.html"
    code, _, complaint = call("certificate", tmp_path / "out", "--out", path, "--poses", 64, "--allow-unconverged")
    assert code == 0, complaint
    check_page(browser, path, tmp_path)
    machine = tiny_experiments.SHIPPED / "m2_hexapod_table" / "machine.toml"
    code, _, complaint = call("show", machine, "--out", tmp_path / "machine.html")
    assert code == 0, complaint
    check_page(browser, tmp_path / "machine.html", tmp_path)
