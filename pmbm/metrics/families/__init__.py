"""Families of metrics, one module each: what is counted, and the metrics made of it."""
