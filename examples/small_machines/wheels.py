"""Odometry of two driven wheels, whose radii and track are found from measured ends of drives: python wheels.py."""

import numpy as np

import bayescal as bc

NOISE = {"wheel": 1e-3, "x": 1.0, "y": 1.0, "heading": 2e-3}  # mm and rad
TOLERANCES = {"r": 1.0, "b": 5.0}


class Wheels(bc.ReadingMachine):
    """A drive is an arc of (r_1 q_1 + r_2 q_2) / 2 that turns by (r_2 q_2 - r_1 q_1) / b; wheel 1 is the left one."""

    member = "wheel"
    parameters = [bc.ParameterBlock("r", (60.0, 60.0), lower=0.0), bc.ParameterBlock("b", (300.0,), per_leg=False)]
    coordinates = [bc.Coordinate(f"q{k}", "rad", 20.0, 15.0) for k in (1, 2)]
    tool_channels = [bc.Channel("x", "mm"), bc.Channel("y", "mm"), bc.Channel("heading", "rad")]
    channels = [
        *(bc.Channel(f"wheel[{k}]", "rad") for k in (1, 2)),
        *(bc.Channel(one.name, one.unit, external=True) for one in tool_channels),
    ]

    def tool(self, parameters, v):
        left, right = parameters["r"][..., 0] * v[..., 0], parameters["r"][..., 1] * v[..., 1]
        way, turn = (left + right) / 2.0, (right - left) / parameters["b"]
        chord = way * np.sinc(turn / (2.0 * np.pi))  # of the arc, along half its turn
        return np.stack([chord * np.cos(turn / 2.0), chord * np.sin(turn / 2.0), turn], axis=-1)

    def read(self, parameters, v, given):
        seen = self.tool(parameters, v)
        return np.concatenate([np.broadcast_to(v, (*seen.shape[:-1], 2)), seen], axis=-1)


if __name__ == "__main__":
    data = bc.simulate(Wheels(), NOISE, TOLERANCES, n_poses=20)
    study = bc.calibrate(Wheels(), data, TOLERANCES)
    print(study.best.parameters.merge(data.truth[["parameter", "true"]])[["parameter", "true", "mean", "sd"]])
