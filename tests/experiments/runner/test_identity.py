"""What belongs to the identity of an experiment that names another one's config."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from bayescal.experiments.runner.load import load

SHIPPED = Path(__file__).parents[3] / "experiments"


@pytest.mark.parametrize(
    ("config", "study"),
    [
        ("m2_hexapod/next_pose.toml", "m2_hexapod/study.toml"),
        ("m2_hexapod_table/table.toml", "m2_hexapod_table/study.toml"),
        ("m2_hexapod_sessions/sessions.toml", "m2_hexapod/study.toml"),
        ("audit/telescope_posterior.toml", "telescope/ridges.toml"),
    ],
)
def test_what_a_named_study_extends_belongs_to_the_identity(tmp_path: Path, config: str, study: str) -> None:
    for folder in {Path(one).parent.name for one in (config, study)} | {"telescope", "m2_hexapod", "audit"}:
        shutil.copytree(SHIPPED / folder, tmp_path / folder)
    before, found = load(tmp_path / config)
    known = before.files(found, (tmp_path / config).parent)
    base = (tmp_path / study).with_name("base.toml")
    (tmp_path / study).rename(base)
    (tmp_path / study).write_text('extends = "base.toml"\n', encoding="utf-8")
    after, found = load(tmp_path / config)
    names = after.files(found, (tmp_path / config).parent)
    added = {(tmp_path / config).parent.joinpath(name).resolve() for name in set(names) - set(known)}
    assert added == {base.resolve()}
    assert len(names) == len(set(names))
