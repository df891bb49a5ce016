"""Videos of clips, alone or side by side: a lit body in perspective on a ground that scrolls, as MP4."""

from __future__ import annotations

from reports.video.encoder import EncoderError, VideoFacts
from reports.video.runs import credit
from reports.video.scene import Panel, Scene, common_camera, render, write_still, write_video

__all__ = [
    "EncoderError",
    "Panel",
    "Scene",
    "VideoFacts",
    "common_camera",
    "credit",
    "render",
    "write_still",
    "write_video",
]
