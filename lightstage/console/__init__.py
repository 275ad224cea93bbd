"""The operator's page: a plan, a live view, devices and sessions, served on this computer alone.

A capture is a process of its own; the page reads its journal and asks it by its socket. So the page
may be closed or opened twice, and the server may die and start again: nothing of a capture changes.
"""
