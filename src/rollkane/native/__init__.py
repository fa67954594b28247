"""Many motions in one compiled loop: the right-hand side as C, and a loop over lanes.

XLA's fusions compute shared intermediate values again and again, and a step of many
lanes goes through memory a hundred times; a kernel of our own keeps it in registers.
"""

from .compiler import NoCompilerError
from .lanes import LaneLoop, Queue, Results, Stops
from .tangents import TangentLoop, Way

__all__ = [
    "LaneLoop",
    "NoCompilerError",
    "Queue",
    "Results",
    "Stops",
    "TangentLoop",
    "Way",
]
