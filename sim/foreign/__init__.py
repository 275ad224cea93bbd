"""People whose light and skin share no formula with `processing`: Mitsuba's own materials."""
