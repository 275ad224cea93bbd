"""A session's life on disk: the journal, photographs kept once, recovery, session.json."""

from lightstage.session.accepted import Accepted, accepted_findings
from lightstage.session.agreement import disagreements, whole_session
from lightstage.session.colour import (
    COLOUR_PATH,
    Carried,
    read_calibration,
    read_colour,
)
from lightstage.session.finished import session_from_journal
from lightstage.session.journal import Journal, utc_now
from lightstage.session.opening import require_new, rig_hash
from lightstage.session.photo_entry import Kept
from lightstage.session.plan import SessionPlan
from lightstage.session.present import require_on_disk, why_not_delete
from lightstage.session.pseudonym import check_consent, check_pseudonym
from lightstage.session.reading import last_run, read_journal
from lightstage.session.reconciling import Reconciled
from lightstage.session.recover import arrived, bring_home, reconcile
from lightstage.session.state import Exposed, SessionState
from lightstage.session.writer import SessionWriter

__all__ = [
    "COLOUR_PATH",
    "Accepted",
    "Carried",
    "Exposed",
    "Journal",
    "Kept",
    "Reconciled",
    "SessionPlan",
    "SessionState",
    "SessionWriter",
    "accepted_findings",
    "arrived",
    "bring_home",
    "check_consent",
    "check_pseudonym",
    "disagreements",
    "last_run",
    "read_calibration",
    "read_colour",
    "read_journal",
    "reconcile",
    "require_new",
    "require_on_disk",
    "rig_hash",
    "session_from_journal",
    "utc_now",
    "whole_session",
    "why_not_delete",
]
