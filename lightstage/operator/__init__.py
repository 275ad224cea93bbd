"""What the operator sees and does, and the stream of events that others follow."""

from lightstage.operator.attendance import (
    Decision,
    Operator,
    OperatorConfig,
    Unattended,
    Wish,
)
from lightstage.operator.events import serve_events
from lightstage.operator.server import EventConfig, EventServer
from lightstage.operator.terminal import TerminalOperator, open_operator

__all__ = [
    "Decision",
    "EventConfig",
    "EventServer",
    "Operator",
    "OperatorConfig",
    "TerminalOperator",
    "Unattended",
    "Wish",
    "open_operator",
    "serve_events",
]
