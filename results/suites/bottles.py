"""The suite quick with 50 seeds, for conclusions."""

from dataclasses import replace

from results.suites.quick import RECIPE as QUICK

RECIPE = replace(QUICK, n_seeds=50)
