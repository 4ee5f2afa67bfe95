"""Scenes, matching, formulas and values that all metrics share."""
