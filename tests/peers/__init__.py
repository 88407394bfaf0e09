"""Clients and servers that nobody here wrote, on our doubles and drivers: ``make wire-peers``."""
