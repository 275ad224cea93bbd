"""The places of a face detector's points on a template, found in pictures of it."""
