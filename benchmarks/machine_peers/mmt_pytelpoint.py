# /// script
# requires-python = ">=3.12,<3.13"
# dependencies = ["pytelpoint==1.0.0", "pymc<5.16", "arviz<1", "setuptools<81"]
# ///
"""The MMT's mount by pytelpoint: stars in, directions of other stars out; arguments: stars, other stars.

Later PyMC has no `ConstantData`, which it calls; later ArviZ does not go with that PyMC.
"""

import json
import sys

import arviz
import astropy.units as u
import numpy as np
from astropy.coordinates import AltAz, SkyCoord
from pytelpoint.fitting import azel_fit, best_fit_pars
from pytelpoint.transform import azel_model

stars, others = (np.genfromtxt(name, delimiter=",")[1:, 1:].T * u.deg for name in sys.argv[1:3])

if __name__ == "__main__":
    sky, encoders = (SkyCoord(*pair, frame=AltAz()) for pair in (stars[:2], stars[2:]))
    draws = azel_fit(sky, encoders, cores=1)
    best, summary = best_fit_pars(draws), arviz.summary(draws, round_to=8)
    found = azel_model(SkyCoord(*others[2:], frame=AltAz()), **best)
    print(
        json.dumps(
            {
                "predicted": np.transpose([found.az.deg, found.alt.deg]).tolist(),
                "terms_arcsec": best,
                "standard_deviations": summary["sd"].to_dict(),
                "rhat": float(summary["r_hat"].max()),
                "ess": float(summary["ess_bulk"].min()),
            }
        )
    )
