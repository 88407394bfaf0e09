"""Drivers: what stands behind the ports of srvs_cell. Each is an entry point of the group ``srvs_cell.drivers``."""
