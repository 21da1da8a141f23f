"""What an audit says on the terminal."""

from __future__ import annotations

import re

from made_up_audit import make_audit_results
from rich.console import Console

from bayescal.experiments.audit.page.build import build_page
from bayescal.experiments.audit.terminal import show_audit


def test_the_terminal_shows_verdict_symbols_and_requirements(capsys):
    results = make_audit_results()
    show_audit(results, build_page(results), Console(width=120))
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 100
    flat = " ".join(text.split())
    assert "Of 7 parameters the 40 planned poses determine 2" in flat
    assert "Everything: all 7 parameters" in flat
    assert "fix" not in flat
    assert re.search(r"│ everything +│ +7 │ +1\.0 │ +90 % │", text)
    assert re.search(r"│ reduced set +│ +4 │ +86 │ +18 % │", text)
    assert re.search(r"│ l +│ mm +│ +2\.0 │ +1\.5 │ +0\.40 │ weak +│", text)
    assert re.search(r"│ rotation about x │ 0\.1 mm │ +0\.0010 mm │ +1 % │ +99\.9 % │ +2\.0 % │", text)
