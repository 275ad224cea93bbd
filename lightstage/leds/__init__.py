"""LED controllers: one Protocol (controller.py), the wire (wire.py), a serial driver."""
