"""Base parameters and DETMAX by figaroh, in an environment of its own; called by peers.py with a file of arrays."""

from __future__ import annotations

import json
import random
import sys
import time
import warnings

import numpy as np
from figaroh.optimal.base_optimal_calibration import Detmax
from figaroh.tools.qrdecomposition import get_baseIndex


def main() -> None:
    """Print what it finds, and how long it takes, as JSON."""
    warnings.simplefilter("ignore")
    random.seed(1)
    with np.load(sys.argv[1]) as given:
        jacobian, blocks, chosen = given["jacobian"], given["blocks"], int(given["chosen"])
    names = [f"p{k}" for k in range(jacobian.shape[1])]
    begun = time.perf_counter()
    base = get_baseIndex(jacobian, names)
    seconds_base = time.perf_counter() - begun
    begun = time.perf_counter()
    search = Detmax(dict(enumerate(blocks)), chosen)
    found: dict[str, object] = {"base": [int(k) for k in base], "seconds_base": seconds_base}
    history = search.main_algo()
    found |= {"criterion": float(history[-1]), "rounds": len(history), "seconds_detmax": time.perf_counter() - begun}
    print(json.dumps(found))


if __name__ == "__main__":
    main()
