"""Photographs to a mesh: poses checked, depth of every view, cross-view consistency, fusion."""
