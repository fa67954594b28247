"""A study in a process of its own, to be killed: ``STORE``."""

import sys

import jax

jax.config.update("jax_enable_x64", True)

import rollkane as rk  # noqa: E402
from tests.small_studies import rolling  # noqa: E402

if __name__ == "__main__":
    how = {"seed": 1, "block": 16}
    rk.monte_carlo(rolling(), 4096, store=sys.argv[1], resume=True, **how)
