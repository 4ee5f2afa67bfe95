"""The detector model: truth in, boxes out that err as a real detector's do."""
