"""Identities for the output: which track goes by which id.  They change no probability."""
