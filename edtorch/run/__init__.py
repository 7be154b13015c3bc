"""Runs: worlds stepped by policies, for training, evaluation and recording, and what they keep."""
