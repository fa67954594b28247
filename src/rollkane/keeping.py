"""Steps that are brought back onto what the motion keeps."""

from collections.abc import Callable
from typing import Any

import diffrax as dfx
import equinox as eqx

from .coordinates import pack, unpack


class Keeping(dfx.AbstractWrappedSolver):
    """A solver whose every step ends on the integrals of the motion.

    For long runs and for motions next to a separatrix, where the rounding of one step
    decides when the next turn comes. What is kept, and how, is the user's to know.

    Attributes:
        solver: A diffrax solver.
        keep: ``keep(state)`` -> the state that the motion can have: a function of
            ``State`` or ``KaneState`` that moves it by no more than the error of a
            step. Its constants are fixed; derivatives pass through it.
        like: Sizes of the state; set by ``simulate``.
    """

    solver: dfx.AbstractSolver
    keep: Callable[[Any], Any] = eqx.field(static=True)
    like: Any = eqx.field(static=True, default=None)

    @property
    def term_structure(self):
        """That of the solver."""
        return self.solver.term_structure

    @property
    def interpolation_cls(self):
        """That of the solver."""
        return self.solver.interpolation_cls

    @property
    def term_compatible_contr_kwargs(self):
        """That of the solver."""
        return self.solver.term_compatible_contr_kwargs

    @property
    def scan_kind(self):
        """That of the solver."""
        return getattr(self.solver, "scan_kind", None)

    def order(self, terms):
        """That of the solver."""
        return self.solver.order(terms)

    def strong_order(self, terms):
        """That of the solver."""
        return self.solver.strong_order(terms)

    def error_order(self, terms):
        """That of the solver."""
        return self.solver.error_order(terms)

    def init(self, terms, t0, t1, y0, args):
        """That of the solver."""
        return self.solver.init(terms, t0, t1, y0, args)

    def func(self, terms, t0, y0, args):
        """That of the solver."""
        return self.solver.func(terms, t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """A step of the solver, brought back."""
        # rates that the solver remembers from its own end would be slightly others
        made_jump = True
        y1, *rest = self.solver.step(terms, t0, t1, y0, args, solver_state, made_jump)
        return pack(self.keep(unpack(y1, self.like))), *rest

    def of(self, like: Any) -> "Keeping":
        """For states of known sizes."""
        return Keeping(self.solver, self.keep, like)
