"""Hydra entry points: configuration in, files out.  Everything that reads or writes is here."""
