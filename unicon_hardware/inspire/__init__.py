"""Inspire RH56 hands, over Modbus or behind DDS services: platform `inspire` and its faces."""
