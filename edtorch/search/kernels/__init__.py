"""The text of the planner's kernels.

Each file is Python that numba compiles.  It is not imported: ``edtorch.search.program`` joins the
files to one module with the decorator ``outer``.  Shapes are those of the arrays that are given.

n states, m actions, H ticks; everything scaled, and time in seconds.  weight [L, K]: of the model;
cost: tuple (rows, weight, action, squash) as ``edtorch.search.plan.Cost`` has them; bounds: tuple
(middle, half) of the actions.
"""
