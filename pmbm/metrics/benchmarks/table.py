"""The rules of tables, which no benchmark has set: CLEAR MOT, identity and HOTA by TrackEval's
matching."""

from __future__ import annotations

from typing import Final

from pmbm.metrics.benchmarks.trackeval import BEV, IOU3D

RULES: Final = {"bev": BEV, "iou3d": IOU3D}
