"""People: who they are, one by one or by the table."""
