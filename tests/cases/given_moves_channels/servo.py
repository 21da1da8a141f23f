"""A servo: the angle that its horn takes at a given pulse width; nothing else is read."""

from bayescal import Channel, ParameterBlock, ReadingMachine


class Servo(ReadingMachine):
    """Straight in the pulse width, which the controller sets exactly."""

    parameters = [
        ParameterBlock("centre", (1500.0,), "us", per_leg=False),
        ParameterBlock("gain", (0.0016,), "rad/us", per_leg=False),
    ]
    coordinates = []
    given = ("pulse_us",)
    channels = [Channel("angle", "rad", external=True)]

    def read(self, p, v, given):
        return (p["gain"] * (given["pulse_us"] - p["centre"]))[..., None]
