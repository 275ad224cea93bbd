"""A day at the stage: the plan of who is captured with which expressions, and what came of it."""

from lightstage.day.plan import (
    PUBLISHED,
    DayPlan,
    PlannedSubject,
    Take,
    read_plan,
    write_plan,
)
from lightstage.day.sessions import Seen, seen_session, sessions_of
from lightstage.day.standing import Planned, next_open, planned, stand_of

__all__ = [
    "PUBLISHED",
    "DayPlan",
    "Planned",
    "PlannedSubject",
    "Seen",
    "Take",
    "next_open",
    "planned",
    "read_plan",
    "seen_session",
    "sessions_of",
    "stand_of",
    "write_plan",
]
