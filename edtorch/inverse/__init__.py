"""Inverse models and inverse policies (paper, section 5)."""
