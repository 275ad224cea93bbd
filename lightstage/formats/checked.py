"""checked.json: what `lightstage check --record` found in a session, and of which session.json."""

from __future__ import annotations

CHECKED = "checked.json"
CHECKED_SCHEMA = "lightstage.checked/1"
