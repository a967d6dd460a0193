"""Serial CAN adapters: the protocol, a bus behind it, and a hub that stands in for hardware."""
