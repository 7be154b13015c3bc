"""Compiled ticks: the learner's arithmetic as numba kernels, for one learner as for many."""
