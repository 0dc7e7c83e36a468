"""Reads what scand writes: models, reports and recordings, as numpy arrays. docs/formats.md describes the files."""

from .model import BRIDGED, CARVED, HULL, PROVENANCES, RESTORED, TABLE, UNSEEN, Model, read_model
from .recording import Capture, ColorView, DepthView, Lens, Recording
from .report import read_report

__all__ = [
    "BRIDGED",
    "CARVED",
    "HULL",
    "PROVENANCES",
    "RESTORED",
    "TABLE",
    "UNSEEN",
    "Capture",
    "ColorView",
    "DepthView",
    "Lens",
    "Model",
    "Recording",
    "read_model",
    "read_report",
]
