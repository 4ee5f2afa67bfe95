"""Real datasets by the same door as simulated scenes: folder -> Recording, tracks -> submission."""

from __future__ import annotations

from pmbm.datasets.origins import with_origins

__all__ = ["with_origins"]
