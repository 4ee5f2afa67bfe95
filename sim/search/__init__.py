"""Searching scenarios for what breaks a tracker."""
