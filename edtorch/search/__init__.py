"""Planned search: trajectories and their gains, computed on a learned mechanism model."""
