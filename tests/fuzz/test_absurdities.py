"""Absurd configs are refused before anything is computed, each with a line that says what was found and expected."""

from __future__ import annotations

import re
import tomllib
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import annotated_types
import pytest
from fuzz.hostile import dump_toml
from fuzz.judged import judge_refusal
from pydantic import BaseModel

from bayescal.config.registry import list_references
from bayescal.experiments.runner.load import find_kind
from bayescal.limits import LARGEST_SEED
from bayescal.machines.readings.line_machine import LineMachineConfig
from bayescal.machines.readings.strut_machine import StrutMachineConfig
from bayescal.machines.schema import LegsMachineConfig, MechanismConfig, SlidingPlatformConfig

AUDIT, STUDY, SELECTION = "audit/m2_hexapod.toml", "telescope/short.toml", "pose_selection/rr8096_figure14.toml"
STAR, OWN = "sika2008/calibrations.toml", "own_machine/study.toml"
TABLE1, TABLE4 = "yu2023/table1.toml", "yu2023/table4.toml"
ROWS: dict[str, tuple[str, str, Any, str]] = {
    "a what-if of 100 GiB": (AUDIT, "scenarios", [{"name": "more", "poses_factor": 1e4}], "expected at most 10000"),
    "a factor beyond everything": (
        AUDIT,
        "scenarios",
        [{"name": "x", "noise_factor": 1e9}],
        "expected less than or equal",
    ),
    "two what-ifs of a name": (AUDIT, "scenarios", [{"name": "x"}, {"name": "x"}], "found 'x' twice"),
    "a million targets": ("telescope/simulate.toml", "targets.base.0.count", 10**6, "less than or equal to 1000"),
    "targets on a pad": ("telescope/simulate.toml", "targets.targets_per_pad", 10**9, "less than or equal to 100"),
    "a million targets of a body": ("rr8096/figure5.toml", "n_targets", [10**6], "less than or equal to 1000"),
    "numbers of targets twice": ("rr8096/figure5.toml", "n_targets", [6, 6], "found 6 twice"),
    "condition of a kilometre": (TABLE4, "study.conditions.0.position_mm", 1e6, "expected less than or equal to 100"),
    "attitude of many turns": (TABLE4, "study.conditions.0.attitude_deg", 1e6, "expected"),
    "condition twice": (TABLE4, "study.conditions.1.name", "I", "found 'I' twice"),
    "index twice": (TABLE4, "study.indices", ["O1", "O1"], "found 'O1' twice"),
    "workspace among its scales": (TABLE4, "study.workspace_scales", [1.0], "found 1, the workspace itself"),
    "poses twice": ("yu2023/figure10.toml", "study.poses", [12, 10, 12], "found 12 twice"),
    "noise of kilometres": (STUDY, "data.0.target_noise_um", 1e9, "expected between 0.0001 and 100000"),
    "noise of nothing": (STUDY, "data.0.target_noise_um", 1e-9, "expected between 0.0001 and 100000"),
    "sensor's noise of kilometres": (AUDIT, "sensors.laser_tracker.position_um", 1e9, "expected between"),
    "sensor's noise of nothing": (STAR, "sensors.s.noise_um", 1e-9, "expected between"),
    "tolerance of nothing": (STUDY, "parameters.a_x.sd", 1e-9, "found a tolerance of 1e-09 mm"),
    "tolerance of a thousand kilometres": (STUDY, "parameters.a_x.sd", 1e9, "found a tolerance of 1e+09 mm"),
    "tolerance of an audit": (AUDIT, "parameters.l.sd", 1e9, "found a tolerance of 1e+09 mm"),
    "tolerance of own readings": (OWN, "parameters.x.sd", 1e-9, "found a tolerance of 1e-09 mm"),
    "kappa of eleven": (STUDY, "deformation.kappa", 11.0, "expected less than or equal to 1"),
    "more than half a turn": (
        SELECTION,
        "domain.rotation_deg",
        [573.0, 1.0, 1.0],
        "less than or equal to 180",
    ),
    "a seed without end": (STUDY, "seed", 10**40, f"less than or equal to {LARGEST_SEED}"),
    "iterations of nothing": (TABLE1, "published.iterations", {"nope": 5}, "found 'nope', expected some of"),
    "a sensor twice": (AUDIT, "variants.0.sensors", ["tracker", "tracker"], "found 'tracker' twice"),
    "a sensor twice in a set": (STAR, "sets.0.sensors", ["s", "s"], "found 's' twice"),
    "a sensor twice in a variant": (OWN, "variants.0.sensors", ["s", "s"], "found 's' twice"),
    "a criterion twice": (SELECTION, "selections.0.criteria", ["O1", "O1"], "found 'O1' twice"),
    "numbers of poses twice": (SELECTION, "selections.0.n_poses", [14, 14], "found 14 twice"),
    "walkers without end": (STUDY, "sampler.steps", 10**9, "expected less than or equal to 100000"),
    "factor of the priors": (STUDY, "sensitivity.prior_width_factors", [1e6], "expected less than or equal to 1000"),
    "drawn machines turned over": (STAR, "machines.guide_turn_deg", [0.0, 200.0], "expected at most 90 in size"),
    "drawn poses turned over": (STAR, "machines.angle_deg", [10.0, 300.0], "expected at most 180 in size"),
}
"""Config, key, what is put there, and what the refusal says."""
ZEROS = {
    TABLE4: "published",
    "yu2023/table8.toml": "published",
    STAR: "published.calibrability",
    TABLE1: "published.table",
}


def refuse(path: Path, key: str, value: Any) -> str:
    """Put something at a dotted key of a config, which has to be refused; return the line in which it is."""
    content = tomllib.loads(path.read_text())
    inner: Any = content
    *before, last = key.split(".")
    for part in before:
        inner = inner[int(part)] if isinstance(inner, list) else inner.setdefault(part, {})
    inner[int(last) if isinstance(inner, list) else last] = value
    other = path.with_name("absurd.toml")
    other.write_text(dump_toml(content))
    return judge_refusal(["validate", other], path.parents[1])


@pytest.mark.parametrize("name", ROWS)
def test_absurdity_is_refused(root, name):
    config, key, value, said = ROWS[name]
    assert said in refuse(root / config, key, value)


def list_bounds(kind: Any, given: tuple[Any, ...] = ()) -> Iterator[tuple[type, set[str]]]:
    """Yield the numbers in a type with the bounds that they have."""
    origin = typing.get_origin(kind)
    kind = getattr(kind, "__value__", getattr(origin, "__value__", kind))
    if typing.get_origin(kind) is typing.Annotated:
        inner, *marks = typing.get_args(kind)
        yield from list_bounds(inner, (*given, *marks))
    elif kind in (int, float):
        marks = [one for mark in given for one in (mark, *getattr(mark, "metadata", ()))]
        above = {"above" for one in marks if isinstance(one, annotated_types.Le | annotated_types.Lt)}
        yield kind, above | {"below" for one in marks if isinstance(one, annotated_types.Ge | annotated_types.Gt)}
    else:
        keep = () if typing.get_origin(kind) in (list, dict) else given
        for one in typing.get_args(kind):
            yield from list_bounds(one, keep)


def list_models(kind: Any) -> Iterator[type[BaseModel]]:
    """Yield the sections in a type, and those in their fields."""
    kind = getattr(kind, "__value__", kind)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
        for field in kind.model_fields.values():
            yield from list_models(field.annotation)
    for one in typing.get_args(kind):
        yield from list_models(one)


SCHEMAS = [find_kind(name, None, None).schema for name in list_references("KINDS")]


@pytest.mark.parametrize(
    "schema",
    [*SCHEMAS, MechanismConfig, LegsMachineConfig, SlidingPlatformConfig, LineMachineConfig, StrutMachineConfig],
)
def test_every_number_has_bounds(schema):
    found = {
        f"{model.__name__}.{name}: {kind.__name__} {sorted(bounds)}"
        for model in set(list_models(schema))
        for name, field in model.model_fields.items()
        for kind, bounds in list_bounds(field.annotation, tuple(field.metadata))
        if len(bounds) < 2
    }
    assert found == set()


@pytest.mark.parametrize("config", ZEROS)
def test_zero_in_a_published_table_is_refused(root, config):
    content: Any = tomllib.loads((root / config).read_text())
    content = content.get("study", content)
    for key in ZEROS[config].split("."):
        content = content[key]
    path = (root / config).parent / content
    original = path.read_text()
    *rows, last = original.strip().splitlines()
    path.write_text("\n".join([*rows, ",".join([*last.split(",")[:-1], "0"])]) + "\n")
    try:
        assert "found 0, expected" in judge_refusal(["validate", root / config], root)
    finally:
        path.write_text(original)


@pytest.mark.parametrize("text", ["\x1b]0;mine\x07", "\u202etxt.exe"])
def test_text_that_commands_a_terminal_is_refused(root, text):
    assert re.search("title: .*control characters", refuse(root / STUDY, "title", text))
