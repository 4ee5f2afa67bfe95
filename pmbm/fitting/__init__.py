"""Fitting the tracker's models to recordings whose detections have known origins."""
