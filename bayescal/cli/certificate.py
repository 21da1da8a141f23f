"""The command that certifies a calibrated machine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayescal.cli.app import app
from bayescal.cli.console import check_out, put
from bayescal.cli.machine import Calibrated, Config, Force, Variant
from bayescal.cli.options import Trust
from bayescal.errors import InputError
from bayescal.limits import LARGEST_SEED

if TYPE_CHECKING:
    from bayescal.calibrated.accuracy import Region
    from bayescal.calibrated.machine import CalibratedMachine


@app.command(epilog="Example: bayescal certificate results/m2_hexapod --out certificate.html")
def certificate(
    results: Calibrated,
    variant: Variant = None,
    out: Annotated[
        Path | None, typer.Option(help="HTML file, its numbers beside it as JSON; default certificate-...html.")
    ] = None,
    coverage: Annotated[float, typer.Option(min=0.5, max=0.9999, help="Probability of what is stated.")] = 0.95,
    cube: Annotated[
        float | None, typer.Option(min=1e-3, max=1e5, help="Edge of ISO 9283's cube, mm; default the largest.")
    ] = None,
    position_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="Half extents about home in x, y, z; default the box of the measured poses."),
    ] = None,
    rotation_deg: Annotated[
        tuple[float, float, float] | None, typer.Option(help="Half extents of the rotation vector, with --position-mm.")
    ] = None,
    whole_range: Annotated[
        bool, typer.Option("--whole-range", help="All over the actuators' range, measured or not.")
    ] = False,
    poses: Annotated[int, typer.Option(min=16, max=100_000, help="Poses of the workspace.")] = 512,
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_SEED - 2, help="Of poses and draws.")] = 0,
    experiment: Config = None,
    force: Force = False,
    trust: Trust = False,
) -> None:
    """Certify how sure the poses of a calibrated machine are: budget, expanded uncertainty, ISO figures."""
    from bayescal.experiments.shared.calibrating import load_calibrated
    from bayescal.experiments.shared.certificate_page import build_certificate, state_headline
    from bayescal.experiments.shared.certify import Wishes, certify
    from bayescal.report.page import render_page
    from bayescal.report.pictures import render_picture

    calibrated = load_calibrated(results, variant, experiment, force, trust)
    if out is not None and out.suffix != ".html":
        raise InputError(f"--out: found {out.name!r}, expected a name that ends with .html; the numbers go beside it")
    where = out or Path(f"certificate-{calibrated.source.stem}.html")
    check_out(where)
    region = _read_region(calibrated, position_mm, rotation_deg, whole_range)
    wishes = Wishes(coverage, poses, cube_mm=cube, seed=seed, region=region, whole_range=whole_range)
    found = certify(calibrated, results, wishes)
    typer.echo(state_headline(found))
    page = build_certificate(found)
    pictures = {figure.name: render_picture(figure.draw) for figure in page.figures() if figure.draw is not None}
    put(render_page(page, pictures), where)
    put(json.dumps(found.list_figures(), indent=1, ensure_ascii=False) + "\n", where.with_suffix(".json"))


def _read_region(
    calibrated: CalibratedMachine,
    position_mm: tuple[float, float, float] | None,
    rotation_deg: tuple[float, float, float] | None,
    whole_range: bool,
) -> Region | None:
    """Return the box that the options state; None for the default, or for the actuators' range."""
    from math import isfinite

    import numpy as np

    from bayescal.calibrated.accuracy import box_about_home

    if whole_range and (position_mm or rotation_deg):
        raise InputError("--whole-range: found beside --position-mm or --rotation-deg, expected either")
    if position_mm is None:
        if rotation_deg is not None:
            raise InputError("--rotation-deg: found without --position-mm, expected both")
        return None
    turned = rotation_deg or (0.0, 0.0, 0.0)
    for name, values in (("--position-mm", position_mm), ("--rotation-deg", turned)):
        if not all(isfinite(value) and value >= 0.0 for value in values):
            raise InputError(f"{name}: found {' '.join(f'{v:g}' for v in values)}, expected half extents of 0 or more")
    units = [one.unit for one in calibrated.model.coordinates]
    half = np.zeros(len(units))
    for unit, name, extents in (
        ("mm", "--position-mm", np.array(position_mm)),
        ("rad", "--rotation-deg", np.radians(turned)),
    ):
        places = [k for k, other in enumerate(units) if other == unit]
        if len(places) == len(extents):
            half[places] = extents
        elif unit == "mm" or places or rotation_deg is not None:
            names = ", ".join(one.name for one in calibrated.model.coordinates)
            raise InputError(f"{name}: found three for coordinates {names}, expected a machine with three of that kind")
    return box_about_home(half)
