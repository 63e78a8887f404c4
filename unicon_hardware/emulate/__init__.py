"""Robots that are not there: their protocols, served on loopback in front of a simulator."""
