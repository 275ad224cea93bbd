"""Where a face detector's points lie on a template, found in pictures of it."""
