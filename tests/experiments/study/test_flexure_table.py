"""How far the end of a bent flexure moves, as a study tabulates it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.experiments.study.tables import tabulate_flexure


def test_table_of_the_flexures():
    table = tabulate_flexure(machines.build_telescope())
    assert table["bending_deg"].iloc[[0, -1]].tolist() == [0.0, 1.0]
    last = table.iloc[-1]
    assert last["along_pivot_um"] / last["along_beam_um"] == pytest.approx(1.5, abs=1e-3)
    assert 0.01 < last["circle_error_nm"] < 0.1
    assert last["circle_error_nm"] == pytest.approx(1e3 * (last["along_circle_um"] - last["along_beam_um"]), rel=1e-6)
    assert last["across_um"] == pytest.approx(1e3 * 5.0 * np.radians(1.0))
    lengths = machines.build_flexures(6).lengths * np.array([1, 1, 2, 2, 1, 1])
    two = tabulate_flexure(machines.build_telescope(flexures=replace(machines.build_flexures(6), lengths=lengths)))
    assert len(two) == 2 * len(table)
    assert tabulate_flexure(machines.build_telescope(flexures=None)).empty
