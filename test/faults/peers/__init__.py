"""Other processes of a fault run: who commands, is a robot behind topics, calls services."""
