"""Many motions in one compiled loop: the right-hand side as C, and a loop over lanes.

XLA's fusions compute shared intermediate values again and again, and a step of many
lanes goes through memory a hundred times; a kernel of our own keeps it in registers.
"""

from .compiler import NoCompilerError
from .derivative_loops import CotangentLoop, Rates, TangentLoop, Way
from .event_layout import Layout
from .lane_loop import LaneLoop, Queue, Results, Stops
from .member_lanes import Bounds, Carried, LaneMode, MemberLanes
from .platforms import platform
from .right_hand_side import Looked, least_product, with_known_zeros, zeros_in, zeros_of
from .run_loop import Course, RunLoop
from .targets import ProgramsAwaited, check_usable, prepare_calls
from .whole_program import Whole, in_one_program, in_one_program_or_not

__all__ = [
    "Bounds",
    "Carried",
    "CotangentLoop",
    "Course",
    "LaneLoop",
    "LaneMode",
    "Layout",
    "Looked",
    "MemberLanes",
    "NoCompilerError",
    "Queue",
    "Rates",
    "Results",
    "RunLoop",
    "Stops",
    "TangentLoop",
    "Way",
    "Whole",
    "check_usable",
    "in_one_program",
    "in_one_program_or_not",
    "least_product",
    "platform",
    "prepare_calls",
    "ProgramsAwaited",
    "with_known_zeros",
    "zeros_in",
    "zeros_of",
]
