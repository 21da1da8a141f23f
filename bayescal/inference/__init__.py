"""From a posterior to its draws and its evidence."""

SAMPLERS = {
    "emcee": "bayescal.inference.samplers:EmceeSampler",
    "nautilus": "bayescal.inference.nautilus:NautilusSampler",
    "smc": "bayescal.inference.samplers:TemperingSampler",
}
