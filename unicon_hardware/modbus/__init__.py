"""Modbus over TCP and RS-485, for hands: frames, links, the wire of a hand, and its face."""
