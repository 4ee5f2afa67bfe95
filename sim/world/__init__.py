"""The world: truth on an integer clock, before any detector looked at it."""
