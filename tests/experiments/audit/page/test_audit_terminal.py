"""What an audit says on the terminal."""

from __future__ import annotations

import re

from made_up_audit import make_audit_results
from rich.console import Console

from bayescal.experiments.audit.page.build import build_page
from bayescal.experiments.audit.terminal import show_audit


def test_the_terminal_shows_verdict_symbols_and_requirements(capsys):
    results = make_audit_results()
    page = build_page(results)
    show_audit(results, page, Console(width=120))
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 100
    assert " ".join(page.headline.split()) in " ".join(text.split())
    assert re.search(r"│ everything +│ +7 │ +1\.0 │ +90 % │", text)
    assert re.search(r"│ reduced set +│ +4 │ +86 │ +18 % │", text)
    assert re.search(r"│ l +│ mm +│ +2\.0 │ +1\.5 │ +0\.40 │ weak +│", text)
    assert re.search(r"│ rotation about x │ 0\.1 mm │ +0\.0010 mm │ +1 % │ +99\.9 % │ +2\.0 % │", text)
