"""Names and words of the package: each class has one name, and retired ones stay retired."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = sorted((ROOT / "bayescal").rglob("*.py"))
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "benchmarks").rglob("*.md")]
NAMES = {
    "ALIKE",
    "ASTRAY",
    "Admitted",
    "Asked",
    "Belief",
    "Beside",
    "Climber",
    "DEAD",
    "DISTRUSTED",
    "Demand",
    "ENOUGH",
    "EVENLY",
    "FarDraws",
    "Fittable",
    "Forecast",
    "Found",
    "FrozenRows",
    "FunctionsOfPose",
    "HARMFUL",
    "Held",
    "INFORMED",
    "KnownErrors",
    "LOST",
    "Left",
    "LoneRows",
    "LowRankComponents",
    "MATTERS",
    "Maker",
    "Misstated",
    "NOTHING",
    "Named",
    "Need",
    "OfAnother",
    "Outlook",
    "OwnChannels",
    "Planned",
    "Prospect",
    "SELDOM",
    "SORTS",
    "STILL",
    "Scouts",
    "Seen",
    "Shown",
    "Sight",
    "Skew",
    "Stand",
    "Standing",
    "Straightening",
    "Stretched",
    "Subject",
    "Suspects",
    "TELLING",
    "TOGETHER",
    "Tails",
    "Thin",
    "Tolerated",
    "Tracked",
    "VAGUE",
    "View",
    "WORTH_REFINING",
    "Watch",
    "Weighed",
    "Weigher",
    "White",
    "Wishes",
    "adopt",
    "approach",
    "draw_far_out",
    "floored",
    "foresee",
    "legs_of",
    "look_around",
    "polish",
    "seen_by",
    "send_scouts",
    "tell_outlook",
}
"""Identifiers that say nothing to a reader of the field, and have standard ones instead."""
WORDS = re.compile(
    r"\b(anew|beforehand|blunders?|doubtful|in place of|no good|of one's own|scouts)\b(?!\")", flags=re.IGNORECASE
)


def test_every_class_has_a_name_of_its_own():
    found = defaultdict(list)
    for path in PACKAGE:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef):
                found[node.name].append(str(path.relative_to(ROOT)))
    assert {name: paths for name, paths in found.items() if len(paths) > 1} == {}


def test_retired_identifiers_are_gone():
    found = []
    for path in PACKAGE:
        for token in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
            if token.type == tokenize.NAME and token.string in NAMES:
                found.append(f"{path.relative_to(ROOT)}:{token.start[0]}: {token.string}")
    assert found == []


def test_retired_words_are_gone():
    found = []
    for path in [*PACKAGE, *PAGES]:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            found += [f"{path.relative_to(ROOT)}:{number}: {one[0]}" for one in WORDS.finditer(line)]
    assert found == []
