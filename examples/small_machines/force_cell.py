"""A force cell of three bridges, under weights that a reference cell reads too: python force_cell.py."""

import numpy as np

import bayescal as bc

NOISE = {"u": 0.0005, "reference": 0.02}  # mV/V and N
TOLERANCES = {"x": 0.002, "y": 0.002, "z": 0.002, "zero": 0.05}


class ForceCell(bc.ReadingMachine):
    """Bridge k reads x_k F_x + y_k F_y + z_k F_z + zero_k: its own direction, and some of the others'."""

    member = "bridge"
    parameters = [
        *(bc.ParameterBlock(axis, tuple(0.01 * np.eye(3)[k]), "mV/(V N)") for k, axis in enumerate("xyz")),
        bc.ParameterBlock("zero", (0.0, 0.0, 0.0), "mV/V"),
    ]
    coordinates = [bc.Coordinate(f"f_{axis}", "N", 0.0, 100.0) for axis in "xyz"]
    channels = [
        *(bc.Channel(f"u[{k}]", "mV/V") for k in (1, 2, 3)),
        *(bc.Channel(f"reference[{axis}]", "N", external=True) for axis in "xyz"),
    ]
    tool_channels = [bc.Channel(f"f_{axis}", "N") for axis in "xyz"]

    def read(self, parameters, v, given):
        bridges = parameters["zero"] + sum(parameters[axis] * v[..., k, None] for k, axis in enumerate("xyz"))
        return np.concatenate(np.broadcast_arrays(bridges, v), axis=-1)


if __name__ == "__main__":
    data = bc.simulate(ForceCell(), NOISE, TOLERANCES, n_poses=25)
    study = bc.calibrate(ForceCell(), data, TOLERANCES)
    print(study.best.parameters.merge(data.truth[["parameter", "true"]])[["parameter", "true", "mean", "sd"]])
    print(study.best.predict({"u_1_mV/V": [0.5], "u_2_mV/V": [0.0], "u_3_mV/V": [0.0]}))
