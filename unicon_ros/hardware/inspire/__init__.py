"""Inspire RH56 hands (FTP) over Modbus TCP or RTU: platform `inspire` and its face."""
