"""The MMT's mount by SciPy's least squares: stars in, directions of other stars out; arguments: stars, other stars."""

import json
import sys

import numpy as np
from scipy.optimize import least_squares

stars, others = (np.radians(np.genfromtxt(name, delimiter=",")[1:, 1:]).T for name in sys.argv[1:3])


def correct(x, encoders):
    """Return directions (2, P) of encoders; x is IA, IE, AN, AW, CA, NPAE, TF, TX in arcsec."""
    a, e = encoders
    ia, ie, an, aw, ca, npae, tf, tx = np.radians(x / 3600.0)
    return np.stack(
        [
            a - ia - (an * np.sin(a) + aw * np.cos(a) + npae) * np.tan(e) - ca / np.cos(e),
            e + ie - an * np.cos(a) + aw * np.sin(a) - tf * np.cos(e) - tx / np.tan(e),
        ]
    )


def residuals(x):
    """Return how far stars are off on the sky, arcsec."""
    off = correct(x, stars[2:]) - stars[:2]
    across = (off[0] + np.pi) % (2.0 * np.pi) - np.pi
    return 3600.0 * np.degrees(np.concatenate([across * np.cos(stars[1]), off[1]]))


fit = least_squares(residuals, np.zeros(8))
covariance = np.linalg.inv(fit.jac.T @ fit.jac) * 2.0 * fit.cost / (len(fit.fun) - len(fit.x))
print(
    json.dumps(
        {
            "predicted": np.degrees(correct(fit.x, others[2:])).T.tolist(),
            "terms_arcsec": fit.x.tolist(),
            "standard_deviations": np.sqrt(np.diag(covariance)).tolist(),
        }
    )
)
