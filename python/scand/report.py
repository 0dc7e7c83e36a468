"""Reads `report.json`: figures, the verdict and its reasons, and the notes on a capture."""

import json
from pathlib import Path


def read_report(path):
    """The report in a file, or in the folder of a capture, as a dictionary; docs/report.schema.json describes it."""
    path = Path(path)
    if path.is_dir():
        path = path / "report.json"
    return json.loads(path.read_text(encoding="utf-8"))
