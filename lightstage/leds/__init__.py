"""LED controllers: one Protocol (controller.py), their URLs (address.py), a driver for each kind.

Our own protocol (wire_leds.py on wire.py), Adalight (adalight.py), E1.31 (sacn.py), and the server
of ICL's stage (icl.py); opening.py opens the one that a URL names.
"""
