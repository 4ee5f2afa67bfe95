"""Lets the tests import the trackers beside them."""
