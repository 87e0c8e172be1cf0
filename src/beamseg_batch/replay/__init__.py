"""A processed flight to a recording that shows it beside the original one."""

from __future__ import annotations

from beamseg_batch.replay.recording import check_views, record_views

__all__ = ["check_views", "record_views"]
