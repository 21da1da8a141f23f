"""Configs: the shipped ones load; every fault is one line with file, field, found and expected."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
import studies
from papers import pose_methods
from refusals import line_of

from bayescal.config.registry import list_references
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.machines.mechanism import ExternalLoad
from bayescal.machines.read import load_mechanism, read_reading_model

LOADERS = dict.fromkeys(("legs", *list_references("MACHINES")), read_reading_model)
SHIPPED = sorted(studies.EXPERIMENTS.rglob("*.toml"))


@pytest.fixture
def study(tmp_path) -> Path:
    """Return the config of a tiny study, without data."""
    studies.write_texts(tmp_path, studies.tiny_texts())
    return tmp_path / "study.toml"


def fail(loader, path: Path, said: str = "expected") -> str:
    """Return the one-line message with which loading fails."""
    message = line_of(loader, path)
    assert message.startswith(str(path))
    assert said in message
    return message


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: str(path.relative_to(studies.EXPERIMENTS)))
def test_every_shipped_config_loads(path):
    text = path.read_text()
    found = re.search(r'^kind = "([\w.:]+)"', text, flags=re.MULTILINE)
    default = load_experiment if re.search(r"(?m)^(extends|study) = ", text) else load_mechanism
    config = (LOADERS.get(found[1], load_experiment) if found else default)(path)
    assert config.name


def test_kind_chooses_the_schema():
    assert isinstance(load_experiment(studies.TELESCOPE / "study.toml"), StudyConfig)
    assert isinstance(load_experiment(studies.EXPERIMENTS / "rr8096/figure5.toml"), pose_methods.PoseMethodsConfig)


# --- misspelt keys ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "field", "suggestion"),
    [
        ("target_um", "target_mm", "noise.target_mm", "target_um"),
        ("unit_mm", "unit", "poses.unit", "unit_mm"),
        ("pad_radius_mm", "pad_radius_m", "targets.pad_radius_m", "pad_radius_mm"),
        ("{ count = 5", "{ cuont = 5", "targets.base.0.cuont", "count"),
        ("[truth.offsets]", "[truth.ofsets]", "truth.ofsets", "offsets"),
        ("seed = 11", "sede = 11", "sede", "seed"),
        ("[sampler]", "[samplers]", "samplers", "sampler"),
        ("[[data]]", "[[date]]", "date", "data"),
        ("[[variants]]", "[[variant]]", "variant", "variants"),
        ("target_noise_um", "target_noise_mm", "data.0.target_noise_mm", "target_noise_um"),
        ("{ noise_um", "{ noise_nm", "sensors.rho.noise_nm", "noise_um"),
        ("random_scale_um", "scale_mm", "model_error.scale_mm", "random_scale_um"),
        ("prior_width_factors = ", "prior_width_factor = ", "sensitivity.prior_width_factor", "prior_width_factors"),
        ("walkers", "walker", "sampler.walker", "walkers"),
        ('free = ["l"]', 'fre = ["l"]', "variants.0.fre", "free"),
        ("sd = 2.0", "sdd = 2.0", "parameters.l.sdd", "sd"),
        ("offset = 0.0", "ofset = 0.0", "parameters.b_z.ofset", "offset"),
    ],
)
def test_misspelt_key_suggests_the_nearest(study, old, new, field, suggestion):
    path = study if old in study.read_text() else study.with_name("simulate.toml")
    studies.edit(path, old, new)
    line = next(n for n, row in enumerate(path.read_text().splitlines(), start=1) if new in row)
    assert re.search(rf"line {line}: {re.escape(field)}: unknown .*{suggestion!r}\?", fail(load_experiment, path))


# --- wrong values ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "field", "found"),
    [
        ("target_noise_um = 3.0", 'target_noise_um = "3 um"', "data.0.target_noise_um", "'3 um'"),
        ("target_noise_um = 3.0", "target_noise_um = true", "data.0.target_noise_um", "True"),
        ("target_noise_um = 3.0", "target_noise_um = nan", "data.0.target_noise_um", "nan"),
        ("target_noise_um = 3.0", "target_noise_um = 0", "data.0.target_noise_um", "0"),
        ("rho = { noise_um = 1.0", "rho = { noise_um = -inf", "sensors.rho.noise_um", "-inf"),
        ("rho = { noise_um = 1.0", "rho = { noise_um = -1.0", "sensors.rho.noise_um", "-1.0"),
        ("sd = 2.0", 'sd = "2 mm"', "parameters.l.sd", "'2 mm'"),
        ("sd = 2.0", "sd = true", "parameters.l.sd", "True"),
        ("sd = 2.0", "sd = -2.0", "parameters.l.sd", "-2.0"),
        ("sd = 2.0", "sd = [1, 2, 3, 4, 5, -6]", "parameters.l.sd.5", "-6"),
        ('"normal", sd = 2.0', '"gauss", sd = 2.0', "parameters.l", "'gauss'"),
        ('{ prior = "normal", sd = 2.0 }', "0.3", "parameters.l", '0.3, expected { prior = "normal", sd = 0.3 }'),
        ('prior = "normal", sd = 2.0', "sd = 2.0", "parameters.l", "no key 'prior'"),
        ("kappa = 0.011", "kappa = 1979-05-27", "deformation.kappa", "datetime.date"),
        ("seed = 11", "seed = 11.0", "seed", "11.0"),
        ("seed = 11", "seed = -1", "seed", "-1"),
        ("seed = 11", "seed = true", "seed", "True"),
        ("separate_by_leg = false", "separate_by_leg = 0", "model_error.separate_by_leg", "0"),
        ('free = ["l"]', 'free = ["l"]\nmodel_error = "smoth"', "variants.0.model_error", "'smoth'"),
        ("ensembles = 4", "ensembles = 3", "sampler.ensembles", "3"),
        ("steps = 10", "steps = 1", "sampler.steps", "1"),
        ("draws = 1000", "draws = 10", "evidence.draws", "10"),
        ("prior_width_factors = [1.0]", "prior_width_factors = 2.0", "sensitivity.prior_width_factors", "2.0"),
        ("prior_width_factors = [1.0]", "prior_width_factors = [2.0, 0]", "sensitivity.prior_width_factors.1", "0"),
        ('free = ["l"]', 'free = "l"', "variants.0.free", "'l'"),
        ('free = ["l"]', "free = []", "variants.0.free", "[]"),
        ('name = "tiny"', 'name = "../elsewhere"', "name", "'../elsewhere'"),
        ("[deformation]", "[[deformation]]", "deformation", "[{"),
    ],
)
def test_wrong_value_names_field_and_value(study, old, new, field, found):
    studies.edit(study, old, new)
    message = fail(load_experiment, study)
    assert f"{field}: found {found}" in message


@pytest.mark.parametrize(
    ("old", "field"),
    [
        ("^seed = 11\n", "seed"),
        ('^file = "data/targets.csv"\n', "data.0.file"),
        (", sd = 2.0", "parameters.l.sd"),
        (r"^\[\[data\]\]\n(?:[^\[\n].*\n|\n)*", "data"),
        (r"^\[parameters\]\n(?:[^\[\n].*\n|\n)*", "parameters"),
        (r"\[\[variants\]\]\n(?:[^\[\n].*\n)*", "variants"),
    ],
)
def test_missing_value_is_not_blamed_on_the_same_key_elsewhere(study, old, field):
    study.write_text(re.sub(old, "", study.read_text(), flags=re.MULTILINE))
    message = fail(load_experiment, study)
    assert f"{field}: missing" in message
    assert ".sd" not in field or f"line {studies.find_line(study, 'l = {')}:" in message


def test_variant_twice(study):
    studies.edit(study, 'deformation = "none"', 'deformation = "matrix"')
    assert "'six_pus/matrix' is" in fail(load_experiment, study)


@pytest.mark.parametrize(("symbol", "why"), [("a_x", "no prior"), ("b_z", "fixed")])
def test_freeing_a_parameter_without_prior(study, symbol, why):
    studies.edit(study, 'free = ["l"]', f'free = ["{symbol}"]')
    assert re.search(f"frees {symbol!r}.* {why}", fail(load_experiment, study))


# --- kind, files -----------------------------------------------------------------------------------------------------


def test_wrong_kind(study):
    studies.edit(study, 'kind = "study"', 'kind = "studdy"')
    kinds = ", ".join(sorted(list_references("KINDS")))
    assert re.search(rf"kind: found 'studdy'.* 'study'\?.* {kinds}", fail(load_experiment, study))
    studies.edit(study, 'kind = "studdy"\n', "")
    assert "kind: found None" in fail(load_experiment, study)


def test_a_wrong_model_is_told_with_its_line(study):
    studies.edit(study, 'model = "six_pus"\ndeformation = "matrix"', 'model = "six_puss"\ndeformation = "matrix"')
    line = studies.find_line(study, 'model = "six_puss"')
    said = f"line {line}: variants.1.model: found 'six_puss', did you mean 'six_pus'?"
    assert said in fail(load_experiment, study)


@pytest.mark.parametrize("value", ["", "eleven", '"eleven', "2 mm", "11\nseed = 12", "11\n[data"])
def test_invalid_toml_names_the_line(study, value):
    studies.edit(study, "seed = 11", f"seed = {value}")
    assert re.search(r"study\.toml: not valid TOML: .*line \d+", fail(load_experiment, study, ""))


@pytest.mark.parametrize("value", ["1" * 5000, "[" * 5000], ids=["digits", "brackets"])
def test_monstrous_toml(study, value):
    studies.edit(study, "seed = 11", f"seed = {value}")
    assert "valid TOML" in fail(load_experiment, study, "")


def test_missing_file_directory_and_binary(study):
    assert "nothing.toml: " in fail(load_experiment, study.with_name("nothing.toml"))
    assert "a TOML config" in fail(load_experiment, study.parent)
    study.write_bytes(b"\xff\xfe\x00")
    assert "line 1: not UTF-8" in fail(load_experiment, study)


def test_byte_order_mark_and_windows_lines_are_fine(study):
    expected = load_experiment(study)
    study.write_bytes(b"\xef\xbb\xbf" + study.read_text().replace("\n", "\r\n").encode())
    assert load_experiment(study) == expected


# --- mechanism -------------------------------------------------------------------------------------------------------


ROD = "{ diameter_mm = 1.0, young_modulus_gpa = 200.0, shear_modulus_gpa = 77.0 }"
BY_NUMBERS = "{ k1_n_mm2 = 9817.5, k2_n = 157080.0, k3_n_mm2 = 7559.5 }"
TWO_WAYS = "expected diameter_mm, young_modulus_gpa and shear_modulus_gpa, or k1_n_mm2, k2_n and k3_n_mm2"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("[265.0, ", "[", "platform: found 5 legs, expected 6 as in base"),
        ("[220.0, ", "[", "platform: found 6 legs, expected 5 as in base"),
        ("length_mm = 500.0", "length_mm = [500.0, 500.0]", "legs.length_mm: found 2 legs, expected 6"),
        ("direction = [0.0, 0.0, 1.0]", "direction = [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]", "legs.direction: found 2"),
        ("direction = [0.0, 0.0, 1.0]", "direction = [0.0, 0.0, 0.0]", "legs.direction: found zero"),
        ("direction = [0.0, 0.0, 1.0]", "direction = [0.0, 1.0]", "legs.direction: found [0.0, 1.0]"),
        ("direction = [0.0, 0.0, 1.0]", "direction = [0.0, 0.0, nan]", "legs.direction.2: found nan, expected"),
        ("position_mm = 10.0", "position_mm = [1, 2, 3, 4, 5]", "legs.initial_actuator_position_mm: found 5 legs"),
        ("length_mm = 500.0", "length_mm = -500.0", "legs.length_mm: found -500.0, expected greater than"),
        ("length_mm = 500.0", 'length_mm = "0.5 m"', "legs.length_mm: found '0.5 m', expected a valid number"),
        ("radius_mm = 155.0", "radius_m = 0.155", "base.radius_m: unknown key, did you mean 'radius_mm'?"),
        ("radius_mm = 155.0\n", "", "base: expected radius_mm with azimuth_deg, or points_mm"),
        ("azimuth_deg = [220.0", "azimuth_rad = [220.0", "base.azimuth_rad: unknown key, did you mean 'azimuth_deg'?"),
        ("[legs]", "[leg]", "leg: unknown key, did you mean 'legs'?"),
        ("length_mm = 10.0", "length_mm = 0.0", "flexures.length_mm: found 0.0, expected greater than"),
        ("length_mm = 10.0", "length_mm = [10, 10, 10, 10, 10, -1]", "flexures.length_mm.5: found -1, expected great"),
        ("length_mm = 10.0", "length_mm = [10, 10, 10, 10, 10]", "flexures.length_mm: found 5 legs, expected 6"),
        ("length_mm = 10.0\n", "", "flexures.length_mm: missing, expected a value"),
        ("beta = 0.25", "beta = 0", "flexures.beta: found 0, expected greater than 0"),
        ("beta = 0.25", "beta = 0.5", "flexures.beta: found 0.5, expected less than 0.5"),
        ("beta = 0.25", "beta = [0.2, 0.2, 0.2, 0.7, 0.2, 0.2]", "flexures.beta.3: found 0.7, expected less than 0.5"),
        ("beta = 0.25", "beta = [0.25, 0.25]", "flexures.beta: found 2 legs, expected 6"),
        ("beta = 0.25", "beta = nan", "flexures.beta: found nan, expected a finite number"),
        ("diameter_mm = 1.0", "diameter_mm = 0", "stiffness.flexure.diameter_mm: found 0, expected greater than"),
        ("diameter_mm = 10.0, young_modulus_gpa = 200", "diameter_mm = 10.0, young_modulus_gpa = -2", "stiffness.leg."),
        ("diameter_mm = 1.0, ", "", f"stiffness.flexure: {TWO_WAYS}"),
        ("{ diameter_mm = 1.0", "{ k1_n_mm2 = 9.0, diameter_mm = 1.0", f"stiffness.flexure: {TWO_WAYS}"),
        (ROD, "{ k1_n_mm2 = 9817.5, k2_n = 157080.0 }", f"stiffness.flexure: {TWO_WAYS}"),
        (ROD, BY_NUMBERS.replace("157080.0", "0.0"), "stiffness.flexure.k2_n: found 0.0, expected greater than"),
        (ROD, BY_NUMBERS.replace("9817.5", "-9.5"), "stiffness.flexure.k1_n_mm2: found -9.5, expected greater than"),
        (f"flexure = {ROD}\n", "", "stiffness.flexure: missing, expected a value"),
        (ROD, "1.0", "stiffness.flexure: found 1.0, expected"),
        ("[flexures]\nlength_mm = 10.0\nbeta = 0.25", "", "found [stiffness], expected [flexures]"),
        ("diameter_mm = 1.0", "diameter_m = 1.0", "flexure.diameter_m: unknown key, did you mean 'diameter_mm'"),
        ("[stiffness]", "[load]\nmass_kg = -1.0\n[stiffness]", "load.mass_kg: found -1.0, expected greater than"),
        ("[stiffness]", "[load]\nforce_n = [1.0, 2.0]\n[stiffness]", "load.force_n: found [1.0, 2.0], expected"),
        ("[stiffness]", "[load]\nmoment_n = [1, 2, 3]\n[stiffness]", "load.moment_n: unknown key, did you mean 'mo"),
    ],
)
def test_faulty_mechanism(study, old, new, expected):
    path = study.with_name("mechanism.toml")
    studies.edit(path, old, new)
    assert expected in fail(load_mechanism, path)


def test_five_legs_are_too_few(study):
    path = study.with_name("mechanism.toml")
    path.write_text(path.read_text().replace("[265.0, ", "[").replace("[220.0, ", "["))
    assert re.search(r"found 5 legs, .*\bleast 6", fail(load_mechanism, path))


def test_flexures_by_rod_or_by_numbers(study):
    """E π d⁴ / 64, E π d² / 4 and G π d⁴ / 32 of the rod; one length and β for all legs or one each."""
    path = study.with_name("mechanism.toml")
    whole = load_mechanism(path).flexures
    assert whole.section.k1 == pytest.approx(200e3 * math.pi / 64)
    assert whole.section.k2 == pytest.approx(200e3 * math.pi / 4)
    assert whole.section.k3 == pytest.approx(77e3 * math.pi / 32)
    assert whole.leg_section.k1 == pytest.approx(1e4 * whole.section.k1)
    studies.edit(path, ROD, BY_NUMBERS)
    studies.edit(path, "length_mm = 10.0", "length_mm = [10, 11, 12, 13, 14, 15]")
    other = load_mechanism(path).flexures
    assert other.lengths.tolist() == [10, 11, 12, 13, 14, 15]
    assert other.beta.tolist() == [0.25] * 6
    assert (other.section.k1, other.section.k2, other.section.k3) == (9817.5, 157080.0, 7559.5)


def test_flexures_without_stiffness_and_neither(study):
    path = study.with_name("mechanism.toml")
    text = path.read_text()
    path.write_text(text[: text.index("[stiffness]")])
    flexures = load_mechanism(path).flexures
    assert (flexures.section, flexures.leg_section) == (None, None)
    path.write_text(text[: text.index("[flexures]")])
    assert load_mechanism(path).flexures is None


def test_load_is_a_weight_and_a_wrench(study):
    path = study.with_name("mechanism.toml")
    assert load_mechanism(path).load == ExternalLoad()
    with path.open("a") as file:
        file.write(
            "[load]\nmass_kg = 10.0\ncentre_of_mass_mm = [1, 2, 3]\nforce_n = [4, 5, 6]\nmoment_n_mm = [7, 8, 9]\n"
        )
    load = load_mechanism(path).load
    assert load.weight == pytest.approx((0.0, 0.0, -98.0665))
    assert (load.centre_of_mass, load.force, load.moment) == ((1, 2, 3), (4, 5, 6), (7, 8, 9))


def test_mechanism_point_by_point_equals_the_circle(study):
    path = study.with_name("mechanism.toml")
    whole = load_mechanism(path)
    points = [[float(x) for x in row] for row in whole.base_points]
    circle = "radius_mm = 155.0\nazimuth_deg = [220.0, 320.0, 340.0, 80.0, 100.0, 200.0]"
    studies.edit(path, circle, f"points_mm = {points}")
    assert (load_mechanism(path).base_points == whole.base_points).all()


# --- faults that show only with the data -----------------------------------------------------------------------------


@pytest.fixture
def data_study(tmp_path) -> Path:
    """Return the config of a tiny study with its data."""
    return studies.write_tiny_study(tmp_path)


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("study.toml", "b_z = {", "bz = {", "parameters: found 'bz', did you mean 'b_z'?"),
        (
            "study.toml",
            'free = ["l"]',
            'free = ["l", "kappa"]',
            "'six_pus/none': free: found 'kappa', expected one of",
        ),
        ("study.toml", 'model = "six_pus"', 'model = "six_puss"', "model: found 'six_puss', did you mean 'six_pus'?"),
        ("study.toml", 'deformation = "none"', 'deformation = "non"', "found 'non', did you mean 'none'?"),
        ("study.toml", "sd = 2.0", "sd = [1.0, 2.0]", "parameters.l: found 2 values, expected 1 or 6"),
        ("study.toml", "offset = 0.0", "offset = [1, 2]", "parameters.b_z: found 2 values, expected 1 or 6"),
        ("study.toml", "seed = 11", 'seed = 11\npublished_claims = "rr8096"', "published_claims: found 'rr8096'"),
        ("study.toml", 'matrix = "targets"', 'matrix = "K.csv"', "K.csv: no such file"),
        ("study.toml", '"mechanism.toml"', '"mechanics.toml"', "mechanics.toml: no such file"),
        ("study.toml", '"mechanism.toml"', '"me\\u0000chanics.toml"', "found control characters"),
        (
            "mechanism.toml",
            "[265.0, 275.0, 25.0, 35.0, 145.0, 155.0]",
            "[220.0, 320.0, 340.0, 80.0, 100.0, 200.0]",
            "singular at home, condition",
        ),
        ("mechanism.toml", "length_mm = 500.0", "length_mm = 20.0", "leg 5 of 20 mm cannot span its joints"),
    ],
)
def test_fault_between_files(data_study, name, old, new, expected):
    studies.edit(data_study.with_name(name), old, new)
    line = line_of(studies.load_study, data_study)
    assert expected in line
    assert name != "mechanism.toml" or f"{data_study.with_name(name)}: " in line
