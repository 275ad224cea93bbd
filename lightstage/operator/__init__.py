"""What the operator sees and does, and the stream of events that others follow."""

from lightstage.operator.attendance import (
    Decision,
    Operator,
    OperatorConfig,
    Unattended,
    Wish,
)
from lightstage.operator.server import EventConfig, EventServer

__all__ = [
    "Decision",
    "EventConfig",
    "EventServer",
    "Operator",
    "OperatorConfig",
    "Unattended",
    "Wish",
]
