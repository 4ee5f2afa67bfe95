"""What all metrics share: scenes, matching, formulas, values."""
