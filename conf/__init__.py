"""Hydra configuration of edtorch's commands, found by them as a package."""
