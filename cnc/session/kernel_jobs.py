"""Jobs: parts of the kernels that are compiled together; see :mod:`cnc.session.kernel_cache`.

The kernels of a job are those that its example calls in the named modules, and all that these call.
A job of more than about ten seconds is divided, so that two processors share the work.
"""

from __future__ import annotations

from typing import NamedTuple


class Job(NamedTuple):
    """A part of the kernels.

    Attributes:
        example: name of the function of :mod:`cnc.session.kernel_examples` that calls them.
        modules: modules whose kernels are compiled.
    """

    example: str
    modules: frozenset[str]


JOBS = {
    name: Job(example, frozenset(f"cnc.{module}" for module in modules.split()))
    for name, example, modules in (
        ("expressions", "evaluate", "gcode.kernels.program"),
        (
            "lines",
            "read",
            "gcode.kernels.automaton gcode.kernels.statements gcode.kernels.line",
        ),
        ("layout", "write_anew", "gcode.kernels.layout"),
        ("paths", "build_simple", "path.kernels.curve path.kernels.arclength"),
        ("intervals", "plan", "planner.kernels.subdivision planner.kernels.limits"),
        ("refinement", "plan", "planner.kernels.refine"),
        (
            "pulses",
            "step",
            "pulses.kernels.reference_pulse path.kernels.curve path.kernels.arclength",
        ),
        ("audit", "audit", "planner.kernels.audit planner.kernels.audit_samples"),
        (
            "planning",
            "plan",
            "planner.kernels.lookahead planner.kernels.scurve planner.kernels.arrays",
        ),
        (
            "NURBS",
            "build_nurbs",
            "path.kernels.bspline path.kernels.span_shape path.kernels.arclength",
        ),
        ("joints", "place_joints", "planner.kernels.joint_records"),
        ("fits", "fit", "path.kernels.fit_program"),
        (
            "knots of fits",
            "fit",
            "path.kernels.fit_spline path.kernels.fit_stretches path.kernels.fit_squares",
        ),
        ("pieces of fits", "fit", "path.kernels.fit_proof path.kernels.fit_pieces"),
        (
            "corner motions",
            "plan_corner",
            "planner.kernels.corner_motion planner.kernels.corner_newton "
            "planner.kernels.corner_rows planner.kernels.corner_tube "
            "planner.kernels.corner_hold planner.kernels.corner_pieces",
        ),
        (
            "corner blends",
            "plan_corner",
            "planner.kernels.corners planner.kernels.legs planner.kernels.corner_bends",
        ),
        (
            "corner stops",
            "plan_corner",
            "planner.kernels.corner_stops planner.kernels.corner_places "
            "planner.kernels.corner_legs planner.kernels.corner_guess "
            "planner.kernels.corner_search",
        ),
        (
            "holds",
            "stop",
            "planner.kernels.stopping planner.kernels.slowed_clock planner.kernels.corner_hold "
            "planner.kernels.timed",
        ),
        ("samples", "sample", "pulses.kernels.sampled"),
        ("GRBL lines", "write_lines", "grbl_lines.kernels.arc_fit grbl_lines.kernels.arrival"),
        ("stock", "cut_stock", "stock.kernels.sweep"),
        (
            "segments",
            "encode",
            "boards.stepper.kernels.segment_encoder boards.stepper.kernels.segments",
        ),
        ("step runs", "encode_runs", "boards.klipper.kernels.step_runs"),
        ("drawing", "draw", "view.kernels.motion view.kernels.thinning"),
    )
}
"""All jobs in the order in which they begin: the longest, and those of which others need much, come
first. A long job at the end would leave the other processors idle."""

BLENDS = ("corner blends", "corner stops", "corner motions")
FITS = ("fits", "knots of fits", "pieces of fits")
PLANNING = ("intervals", "refinement", "planning", "audit")
READING = ("expressions", "lines", "paths")
CHECKING = (*READING, *PLANNING, "pulses")
"""What nearly every program needs."""
