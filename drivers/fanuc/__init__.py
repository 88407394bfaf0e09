"""FANUC robot drivers."""
