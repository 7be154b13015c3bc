"""The text of the kernels.

Each file is Python that numba compiles.  It is not imported: ``edtorch.native.source`` joins the
files to one module for each plan, together with the plan's sizes and places of rows (names in
capitals), the functions chosen for ``fit``, ``value``, ``step`` and ``command``, and those of the
simulator; ``edtorch.compiled`` adds the decorators ``inner`` and ``outer``.

``LANES`` learners are computed side by side.  Row r of learner l is ``z[r * LANES + l]``, and every
loop over learners is the outermost of its block, with the loops over rows inside: the compiler
unrolls these and computes several learners with one instruction.  No sum changes its order, so that
a learner's digits are the same in any lane.

z: what learners keep (float64); k: their counters (int64); s: scratch (float64); number: the
settings of the plan.
"""
