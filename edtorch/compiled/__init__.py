"""Compiled ticks: populations by Inductor, ahead of time."""
