"""Where lamps stand, how strong they are and which wire lights which, from balls."""
