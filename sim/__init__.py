"""Synthetic traffic: scenes, a detector that errs like a real one, scenarios."""
