"""Scenarios: named worlds, as TOML files, that give a recording for a seed."""
